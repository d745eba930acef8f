#pragma once

#include <functional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// A folder that rosbag2 recorded: metadata.yaml and the files that it names.
struct BagFolder {
  std::vector<std::string> files;  // in the order of recording, with the folder
  bool messages_packed = false;    // every message is a zstd frame of its own
  std::vector<std::string> notes;  // that metadata.yaml is missing
};

// Without metadata.yaml, which a recorder writes last, the folder's .mcap and .db3 files in the
// order of their numbers. INVALID_ARGUMENT names file, key and value: a file that is missing, a
// compression that is not known.
absl::StatusOr<BagFolder> OpenBagFolder(const std::string& folder);

// Whether a folder is one: it has metadata.yaml, or such files.
bool IsBagFolder(const std::string& folder);

// Whether a file's name is that of a bag's, packed or not.
bool IsMcapName(const std::string& name);
bool IsDb3Name(const std::string& name);

// The files of a folder whose names are wanted, "x_10" behind "x_9".
std::vector<std::string> FilesByNumber(const std::string& folder,
                                       const std::function<bool(const std::string&)>& wanted);

}  // namespace robostress
