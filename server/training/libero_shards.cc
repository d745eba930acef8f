#include "server/training/libero_shards.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/libero/demonstrations.h"
#include "common/safetensors.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// A shard in the making.
struct Frames {
  std::vector<uint8_t> images;
  std::vector<float> state, actions, aux;
  std::vector<int64_t> episode;
};

void AppendState(const LiberoColumns& columns, int64_t t, std::vector<float>& state) {
  const auto add = [&](const std::vector<double>& values, int64_t width) {
    for (int64_t i = 0; i < width; ++i) state.push_back(static_cast<float>(values[t * width + i]));
  };
  if (!columns.proprioception.empty()) return add(columns.proprioception, 8);
  add(columns.ee_pos, 3);
  add(columns.ee_ori, 3);
  add(columns.gripper_states, 2);
}

void AppendLabel(const LiberoColumns& columns, bool absolute, int64_t first, int64_t horizon,
                 std::vector<float>& label) {
  for (int64_t k = 0; k < horizon; ++k) {
    const bool over = first + k >= columns.steps && !absolute;
    const double* row = &columns.actions[7 * std::min(first + k, columns.steps - 1)];
    for (int j = 0; j < 7; ++j) label.push_back(over && j < 6 ? 0.0f : static_cast<float>(row[j]));
  }
}

absl::Status AppendDemonstration(const LiberoDemonstrationFile& file, int64_t index,
                                 const NanoConfig& config, int stride, Frames& frames) {
  RS_ASSIGN_OR_RETURN(const LiberoColumns columns, file.ReadColumns(index));
  using View = LiberoDemonstrationFile::View;
  for (int64_t t = 0; t < columns.steps; t += stride) {
    for (const View view : {View::kAgent, View::kEyeInHand}) {
      RS_ASSIGN_OR_RETURN(Image image, file.ReadView(index, view, t));
      if (!file.has_proprioception()) image = MirrorColumns(image);
      image = ResizeArea(image, config.image_size, config.image_size);
      frames.images.insert(frames.images.end(), image.data.begin(), image.data.end());
    }
    AppendState(columns, t, frames.state);
    AppendLabel(columns, file.absolute_actions(), t, config.horizon, frames.actions);
    for (int i = 0; i < 8 && file.has_aux(); ++i)
      frames.aux.push_back(static_cast<float>(columns.aux[8 * t + i]));
    frames.episode.push_back(index);
  }
  return absl::OkStatus();
}

// What a shard is a function of, as its metadata.
using ShardSource = std::map<std::string, std::string>;

absl::StatusOr<ShardSource> SourceOf(const std::string& path, const NanoConfig& config,
                                     int stride) {
  RS_ASSIGN_OR_RETURN(const std::string hash, Sha256OfFile(path));
  return ShardSource{{"source", path},
                     {"source_sha256", hash},
                     {"stride", absl::StrCat(stride)},
                     {"image_size", absl::StrCat(config.image_size)},
                     {"horizon", absl::StrCat(config.horizon)}};
}

bool MadeFrom(const ShardSource& source, const std::string& shard) {
  if (!fs::exists(shard)) return false;
  const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(shard);
  return file.ok() && std::all_of(source.begin(), source.end(), [&](const auto& entry) {
           const auto found = file->metadata().find(entry.first);
           return found != file->metadata().end() && found->second == entry.second;
         });
}

}  // namespace

absl::Status ConvertLiberoFile(const std::string& path, const NanoConfig& config, int stride,
                               const std::string& shard) {
  RS_ASSIGN_OR_RETURN(const LiberoDemonstrationFile file, LiberoDemonstrationFile::Open(path));
  if (config.cameras.size() != 2 || config.state_dim != 8 || config.action_dim != 7) {
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": LIBERO's form has 2 views, 8 state and 7 action dimensions, the network ",
        config.cameras.size(), ", ", config.state_dim, " and ", config.action_dim));
  }
  Frames frames;
  for (int64_t i = 0; i < file.demonstrations(); ++i)
    RS_RETURN_IF_ERROR(AppendDemonstration(file, i, config, stride, frames));
  const int64_t count = static_cast<int64_t>(frames.episode.size()), size = config.image_size;
  SafetensorsWriter writer;
  writer.SetMetadata("instruction", file.instruction());
  RS_ASSIGN_OR_RETURN(const ShardSource source, SourceOf(path, config, stride));
  for (const auto& [key, value] : source) writer.SetMetadata(key, value);
  writer.SetMetadata("version", "1");
  writer.Add("images", DType::kU8, {count, 2, size, size, 3}, frames.images.data(),
             frames.images.size());
  writer.AddFloats("state", {count, 8}, frames.state);
  writer.AddFloats("actions", {count, config.horizon, 7}, frames.actions);
  if (file.has_aux()) writer.AddFloats("aux", {count, 8}, frames.aux);
  writer.AddInts("episode", {count}, frames.episode);
  return writer.Write(shard);
}

absl::StatusOr<std::vector<std::string>> PrepareShards(const std::vector<std::string>& data,
                                                       const NanoConfig& config, int stride,
                                                       const std::string& converted) {
  std::vector<std::string> directories, files;
  for (const std::string& entry : data) {
    std::error_code error;
    if (fs::path(entry).extension() == ".hdf5") {
      files.push_back(entry);
      continue;
    }
    std::vector<std::string> inside;
    bool shards = false;
    for (fs::recursive_directory_iterator it(entry, error), end; !error && it != end;
         it.increment(error)) {
      if (it->path().extension() == ".hdf5") inside.push_back(it->path().string());
      shards |= it->path().extension() == ".safetensors";
    }
    std::sort(inside.begin(), inside.end());
    files.insert(files.end(), inside.begin(), inside.end());
    if (shards || inside.empty()) directories.push_back(entry);
  }
  if (files.empty()) return directories;
  RS_RETURN_IF_ERROR(MakeDirectories(converted));
  std::set<std::string> shards;
  for (size_t i = 0; i < files.size(); ++i) {
    const std::string shard =
        absl::StrFormat("%s/%03d_%s.safetensors", converted, i, fs::path(files[i]).stem().string());
    shards.insert(shard);
    RS_ASSIGN_OR_RETURN(const ShardSource source, SourceOf(files[i], config, stride));
    if (!MadeFrom(source, shard))
      RS_RETURN_IF_ERROR(ConvertLiberoFile(files[i], config, stride, shard));
  }
  // Of an earlier try with other data.
  std::error_code error;
  for (fs::directory_iterator it(converted, error), end; !error && it != end; it.increment(error)) {
    const fs::path file = it->path();
    std::error_code ignored;
    if (file.extension() == ".safetensors" && !shards.contains(file.string()))
      fs::remove(file, ignored);
  }
  directories.push_back(converted);
  return directories;
}

}  // namespace robostress
