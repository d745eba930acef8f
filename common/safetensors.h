#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"

namespace robostress {

enum class DType { kBool, kU8, kI8, kI16, kI32, kI64, kF16, kBF16, kF32, kF64 };
int DTypeSize(DType dtype);  // [bytes]
const char* DTypeName(DType dtype);

// One tensor's place in a file that was checked as a whole.
struct TensorView {
  DType dtype = DType::kF32;
  std::vector<int64_t> shape;
  absl::Span<const uint8_t> bytes;  // little-endian, row-major, valid while the file is open
  int64_t num_elements() const;
};

// A memory-mapped safetensors file. Open trusts nothing: header length, JSON, dtypes, shapes,
// overflow, overlaps, holes, length of the file; an error names file, tensor and value.
class SafetensorsFile {
 public:
  static absl::StatusOr<SafetensorsFile> Open(const std::string& path);
  static absl::StatusOr<SafetensorsFile> Parse(const std::string& name, std::string bytes);
  SafetensorsFile(SafetensorsFile&&) noexcept;
  SafetensorsFile& operator=(SafetensorsFile&&) noexcept;
  ~SafetensorsFile();

  const std::string& path() const { return path_; }
  uint64_t file_bytes() const;
  // Gives the pages that lie wholly in `bytes`, a part of a tensor, back to the system; the next
  // read brings them from the file again. Keeps a large tensor's conversion from holding it twice.
  void ReleasePages(absl::Span<const uint8_t> bytes) const;
  const std::map<std::string, std::string>& metadata() const { return metadata_; }
  const std::map<std::string, TensorView>& tensors() const { return tensors_; }
  absl::StatusOr<TensorView> Get(const std::string& name) const;
  // Converting reads; the shape must match where given (-1: any).
  absl::StatusOr<std::vector<double>> ReadDoubles(const std::string& name,
                                                  const std::vector<int64_t>& shape = {}) const;
  absl::StatusOr<std::vector<float>> ReadFloats(const std::string& name,
                                                const std::vector<int64_t>& shape = {}) const;

 private:
  struct Storage;
  SafetensorsFile();
  static absl::StatusOr<SafetensorsFile> ParseStorage(const std::string& path,
                                                      std::unique_ptr<Storage> storage);
  std::string path_;
  std::unique_ptr<Storage> storage_;
  std::map<std::string, std::string> metadata_;
  std::map<std::string, TensorView> tensors_;
};

// Collects tensors and publishes them as one file (temporary file, fsync, rename).
class SafetensorsWriter {
 public:
  void SetMetadata(const std::string& key, const std::string& value) { metadata_[key] = value; }
  // Copies `bytes`; its size must be product(shape) * size of dtype (checked).
  void Add(const std::string& name, DType dtype, std::vector<int64_t> shape, const void* bytes,
           size_t size);
  void AddFloats(const std::string& name, std::vector<int64_t> shape,
                 absl::Span<const float> values);
  void AddDoubles(const std::string& name, std::vector<int64_t> shape,
                  absl::Span<const double> values);
  void AddInts(const std::string& name, std::vector<int64_t> shape,
               absl::Span<const int64_t> values);
  absl::StatusOr<std::string> Serialize() const;
  absl::Status Write(const std::string& path) const;

 private:
  struct Entry {
    DType dtype;
    std::vector<int64_t> shape;
    std::string bytes;
  };
  std::map<std::string, std::string> metadata_;
  std::map<std::string, Entry> entries_;
};

}  // namespace robostress
