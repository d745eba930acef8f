#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// A text file that grows by rows. Whatever a full disk does to it, it ends with a whole row. One
// thread.
class RowFile {
 public:
  // ALREADY_EXISTS where it is there; UNAVAILABLE with the system's reason.
  static absl::StatusOr<std::unique_ptr<RowFile>> Create(const std::string& file);
  ~RowFile();  // what was not flushed is lost
  RowFile(const RowFile&) = delete;
  RowFile& operator=(const RowFile&) = delete;

  void Add(const std::string& row) { waiting_.append(row).push_back('\n'); }
  // Hands the rows to the system. After an error (UNAVAILABLE) the file ends where it did before,
  // and every call returns it.
  absl::Status Flush();

 private:
  RowFile(std::string file, int descriptor) : file_(std::move(file)), descriptor_(descriptor) {}

  const std::string file_;
  const int descriptor_;
  int64_t size_ = 0;  // bytes that were handed over
  std::string waiting_;
  absl::Status failed_;
};

}  // namespace robostress
