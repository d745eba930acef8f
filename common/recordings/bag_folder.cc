#include "common/recordings/bag_folder.h"

#include <algorithm>
#include <filesystem>
#include <string>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/recordings/byte_source.h"
#include "common/status_macros.h"
#include "yaml-cpp/yaml.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr uint64_t kMostMetadata = uint64_t{64} << 20;
constexpr size_t kMostFiles = 100'000;
constexpr char kRoot[] = "rosbag2_bagfile_information";

std::string Unpacked(const std::string& name) {
  absl::string_view rest = name;
  if (IsZstdName(rest)) rest = rest.substr(0, rest.rfind('.'));
  return std::string(rest);
}

// "bag_10.mcap" behind "bag_9.mcap": by the number before the ending.
std::pair<int64_t, std::string> NumberOf(const std::string& name) {
  std::string stem = Unpacked(name);
  stem = stem.substr(0, stem.rfind('.'));
  size_t digits = stem.size();
  while (digits > 0 && absl::ascii_isdigit(static_cast<unsigned char>(stem[digits - 1]))) --digits;
  int64_t number = -1;
  if (!absl::SimpleAtoi(stem.substr(digits), &number)) number = -1;
  return {number, name};
}

std::vector<std::string> BagFiles(const std::string& folder) {
  return FilesByNumber(folder,
                       [](const std::string& name) { return IsMcapName(name) || IsDb3Name(name); });
}

std::string TextAt(const YAML::Node& node, const char* key) {
  const YAML::Node value = node[key];
  return value && value.IsScalar() ? absl::AsciiStrToLower(value.Scalar()) : "";
}

// The names in metadata.yaml; its writer may have left out that a file is packed, and old ones put
// the folder before it.
absl::Status TakeNames(const std::string& path, const YAML::Node& names, const fs::path& folder,
                       BagFolder* bag) {
  if (!names || !names.IsSequence() || names.size() == 0 || names.size() > kMostFiles)
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", kRoot, ".relative_file_paths must list files"));
  for (const YAML::Node& entry : names) {
    const std::string name = entry.IsScalar() ? fs::path(entry.Scalar()).filename().string() : "";
    std::string found;
    for (const std::string& candidate : {name, name + ".zstd", Unpacked(name)}) {
      std::error_code error;
      if (!candidate.empty() && fs::is_regular_file(folder / candidate, error)) {
        found = (folder / candidate).string();
        break;
      }
    }
    if (found.empty() || !(IsMcapName(found) || IsDb3Name(found)))
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": ", kRoot, ".relative_file_paths names '", name,
                       "', which is no .mcap or .db3 file of this folder; copy it here, or remove "
                       "metadata.yaml to read the files that are here"));
    bag->files.push_back(std::move(found));
  }
  return absl::OkStatus();
}

absl::StatusOr<BagFolder> Read(const std::string& path, const std::string& text) {
  const YAML::Node document = YAML::Load(text);
  const YAML::Node root = document.IsMap() ? document[kRoot] : YAML::Node();
  if (!root || !root.IsMap())
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": has no ", kRoot, "; is it of a folder that rosbag2 recorded?"));
  const std::string format = TextAt(root, "compression_format");
  const std::string mode = TextAt(root, "compression_mode");
  BagFolder bag;
  bag.messages_packed = mode == "message";
  if (!format.empty() && format != "none" && format != "zstd")
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": ", kRoot, ".compression_format is '", format, "'; read is zstd"));
  if (!mode.empty() && mode != "none" && mode != "file" && mode != "message")
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", kRoot, ".compression_mode is '",
                                                   mode, "'; read are file and message"));
  RS_RETURN_IF_ERROR(
      TakeNames(path, root["relative_file_paths"], fs::path(path).parent_path(), &bag));
  return bag;
}

}  // namespace

std::vector<std::string> FilesByNumber(const std::string& folder,
                                       const std::function<bool(const std::string&)>& wanted) {
  std::vector<std::pair<int64_t, std::string>> found;
  std::error_code error;
  for (fs::directory_iterator entry(folder, error), end; !error && entry != end;
       entry.increment(error)) {
    const std::string name = entry->path().filename().string();
    if (wanted(name) && found.size() < kMostFiles) found.push_back(NumberOf(name));
  }
  std::sort(found.begin(), found.end());
  std::vector<std::string> names;
  for (auto& [number, name] : found) names.push_back(std::move(name));
  return names;
}

bool IsMcapName(const std::string& name) { return absl::EndsWith(Unpacked(name), ".mcap"); }
bool IsDb3Name(const std::string& name) { return absl::EndsWith(Unpacked(name), ".db3"); }

bool IsBagFolder(const std::string& folder) {
  std::error_code error;
  return fs::is_regular_file(fs::path(folder) / "metadata.yaml", error) ||
         !BagFiles(folder).empty();
}

absl::StatusOr<BagFolder> OpenBagFolder(const std::string& folder) {
  const std::string path = (fs::path(folder) / "metadata.yaml").string();
  std::error_code error;
  if (!fs::exists(path, error)) {
    BagFolder bag;
    for (const std::string& name : BagFiles(folder))
      bag.files.push_back((fs::path(folder) / name).string());
    if (bag.files.empty())
      return absl::InvalidArgumentError(
          absl::StrCat(folder, ": holds neither metadata.yaml nor .mcap or .db3 files"));
    bag.notes.push_back(absl::StrCat(folder, ": has no metadata.yaml, its recorder did not close ",
                                     "it; read are its ", bag.files.size(), " files by number"));
    return bag;
  }
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMostMetadata));
  try {
    return Read(path, text);
  } catch (const YAML::Exception& exception) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": not YAML: ", exception.what()));
  }
}

}  // namespace robostress
