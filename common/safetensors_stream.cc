#include "common/safetensors_stream.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

// Length and text of the header, padded so that the data begins at a multiple of 8.
absl::StatusOr<std::string> Header(const std::map<std::string, std::string>& metadata,
                                   const std::vector<SafetensorsStream::Entry>& entries) {
  nlohmann::json header = nlohmann::json::object();
  if (!metadata.empty()) header["__metadata__"] = metadata;
  uint64_t offset = 0;
  for (const SafetensorsStream::Entry& entry : entries) {
    if (header.contains(entry.name)) {
      return absl::InvalidArgumentError(absl::StrCat("tensor '", entry.name, "' is listed twice"));
    }
    const uint64_t end = offset + entry.bytes();
    header[entry.name] = {
        {"dtype", DTypeName(entry.dtype)}, {"shape", entry.shape}, {"data_offsets", {offset, end}}};
    offset = end;
  }
  std::string text = header.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
  text.append((8 - text.size() % 8) % 8, ' ');
  const uint64_t size = text.size();
  return std::string(reinterpret_cast<const char*>(&size), sizeof(size)) + text;
}

}  // namespace

uint64_t SafetensorsStream::Entry::bytes() const {
  uint64_t bytes = DTypeSize(dtype);
  for (const int64_t extent : shape) bytes *= static_cast<uint64_t>(extent);
  return bytes;
}

absl::StatusOr<SafetensorsStream> SafetensorsStream::Create(
    const std::string& path, const std::map<std::string, std::string>& metadata,
    const std::vector<Entry>& entries) {
  RS_ASSIGN_OR_RETURN(const std::string header, Header(metadata, entries));
  RS_ASSIGN_OR_RETURN(AtomicStream file, AtomicStream::Create(path));
  RS_RETURN_IF_ERROR(file.Append(header));
  uint64_t data = 0;
  for (const Entry& entry : entries) data += entry.bytes();
  return SafetensorsStream(std::move(file), data);
}

absl::Status SafetensorsStream::Append(absl::Span<const uint8_t> bytes) {
  if (bytes.size() > remaining_) {
    return absl::FailedPreconditionError(absl::StrCat(
        file_.path(), ": ", bytes.size(), " bytes to write, its header has room for ", remaining_));
  }
  remaining_ -= bytes.size();
  return file_.Append({reinterpret_cast<const char*>(bytes.data()), bytes.size()});
}

absl::Status SafetensorsStream::Finish() {
  if (remaining_ != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(file_.path(), ": ", remaining_, " bytes of its header's are missing"));
  }
  return file_.Publish();
}

}  // namespace robostress
