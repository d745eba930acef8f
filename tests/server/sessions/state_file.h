#pragma once

#include <gtest/gtest.h>

#include <cstring>
#include <map>
#include <string>
#include <vector>

#include "common/safetensors.h"

namespace robostress {

// An exported adapter whose parts can be changed one by one.
struct StateFile {
  struct Entry {
    DType dtype = DType::kF32;
    std::vector<int64_t> shape;
    std::string bytes;

    // Another shape or type, with the bytes that it needs.
    void Resize() {
      size_t size = static_cast<size_t>(DTypeSize(dtype));
      for (const int64_t extent : shape) size *= static_cast<size_t>(extent);
      bytes.resize(size);
    }
    template <class T>
    void Set(size_t index, T value) {
      ASSERT_LE((index + 1) * sizeof value, bytes.size());
      std::memcpy(bytes.data() + index * sizeof value, &value, sizeof value);
    }
  };

  static StateFile Parse(const std::string& bytes) {
    const auto file = SafetensorsFile::Parse("state", bytes);
    EXPECT_TRUE(file.ok()) << file.status();
    StateFile result;
    result.metadata = file->metadata();
    for (const auto& [name, view] : file->tensors()) {
      result.tensors[name] = {
          view.dtype, view.shape,
          std::string(reinterpret_cast<const char*>(view.bytes.data()), view.bytes.size())};
    }
    return result;
  }

  std::string Serialize() const {
    SafetensorsWriter writer;
    for (const auto& [key, value] : metadata) writer.SetMetadata(key, value);
    for (const auto& [name, entry] : tensors)
      writer.Add(name, entry.dtype, entry.shape, entry.bytes.data(), entry.bytes.size());
    const auto bytes = writer.Serialize();
    EXPECT_TRUE(bytes.ok()) << bytes.status();
    return *bytes;
  }

  std::map<std::string, std::string> metadata;
  std::map<std::string, Entry> tensors;
};

}  // namespace robostress
