#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "absl/status/statusor.h"

namespace robostress::libero {

// The bytes of the first entry of a zip file whose name ends in `suffix`, stored or deflated, its
// checksum checked; found through the central directory (local headers may carry no sizes). An
// entry of more than `max_bytes` is refused before it is unpacked. NotFound: no such entry.
// InvalidArgument says what is broken; neither names a file.
absl::StatusOr<std::string> ReadZipEntry(std::string_view zip, std::string_view suffix,
                                         size_t max_bytes);

}  // namespace robostress::libero
