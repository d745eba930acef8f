#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/safetensors.h"
#include "server/policies/openpi/checkpoint_generator.h"
#include "server/policies/openpi/generated_files.h"
#include "tests/server/policies/tiny_checkpoint.h"

// Generated checkpoints, and ways to damage them.
namespace robostress::openpi {

namespace fs = std::filesystem;

// A fresh path below a folder of this process, which goes with it; nothing is there.
inline fs::path FreshPath(const std::string& name) {
  static const struct Folder {
    Folder() { fs::create_directories(path); }
    ~Folder() { fs::remove_all(path); }
    fs::path path = fs::path(::testing::TempDir()) / absl::StrCat("checkpoints.", ::getpid());
  } folder;
  fs::remove_all(folder.path / name);
  return folder.path / name;
}

// Writes a tiny checkpoint into a fresh folder `name`.
inline fs::path Generate(const std::string& name, GeneratorOptions options) {
  const fs::path path = FreshPath(name);
  options.out = path.string();
  const absl::Status status = GenerateCheckpoint(options);
  EXPECT_TRUE(status.ok()) << status;
  return path;
}

struct RawTensor {
  DType dtype;
  std::vector<int64_t> shape;
  std::string bytes;
};
struct RawFile {
  std::map<std::string, std::string> metadata;
  std::map<std::string, RawTensor> tensors;
};

inline RawFile ReadRaw(const fs::path& path) {
  const auto file = SafetensorsFile::Open(path.string());
  EXPECT_TRUE(file.ok()) << file.status();
  RawFile raw;
  raw.metadata = file->metadata();
  for (const auto& [name, view] : file->tensors()) {
    const std::string bytes(reinterpret_cast<const char*>(view.bytes.data()), view.bytes.size());
    raw.tensors[name] = {view.dtype, view.shape, bytes};
  }
  return raw;
}

inline void WriteRaw(const fs::path& path, const RawFile& raw) {
  SafetensorsWriter writer;
  for (const auto& [key, value] : raw.metadata) writer.SetMetadata(key, value);
  for (const auto& [name, t] : raw.tensors)
    writer.Add(name, t.dtype, t.shape, t.bytes.data(), t.bytes.size());
  const absl::Status status = writer.Write(path.string());
  EXPECT_TRUE(status.ok()) << status;
}

inline void Edit(const fs::path& path, const std::function<void(RawFile&)>& change) {
  RawFile raw = ReadRaw(path);
  change(raw);
  WriteRaw(path, raw);
}

inline void EditJson(const fs::path& path, const std::function<void(nlohmann::json&)>& change) {
  nlohmann::json json = nlohmann::json::parse(std::ifstream(path));
  change(json);
  std::ofstream(path) << json;
}

// A file with a whole header whose data is a hole: any size, no disk.
inline void WriteHollow(const fs::path& path, const std::vector<SafetensorsStream::Entry>& entries,
                        const std::map<std::string, std::string>& metadata = {}) {
  nlohmann::json header = nlohmann::json::object();
  if (!metadata.empty()) header["__metadata__"] = metadata;
  uint64_t offset = 0;
  for (const auto& entry : entries) {
    header[entry.name] = {{"dtype", DTypeName(entry.dtype)},
                          {"shape", entry.shape},
                          {"data_offsets", {offset, offset + entry.bytes()}}};
    offset += entry.bytes();
  }
  std::string text = header.dump();
  text.append((8 - text.size() % 8) % 8, ' ');
  const uint64_t size = text.size();
  fs::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary)
      << std::string(reinterpret_cast<const char*>(&size), 8) << text;
  fs::resize_file(path, 8 + size + offset);
}

}  // namespace robostress::openpi
