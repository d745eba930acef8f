#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "absl/functional/function_ref.h"
#include "absl/status/status.h"
#include "absl/status/statusor.h"

// A file of records. Each is framed, little-endian:
//   magic "RSR1" u32 | length u32 | number u64 | crc u32 | payload [length]
// number counts 1, 2, 3 ... in the file; crc is CRC-32 (zlib) over length, number and payload.
namespace robostress {

inline constexpr uint32_t kMaxRecordBytes = 1u << 30;

// Appends to one file. One writer of a file; Sync may run beside Append on another thread.
class RecordWriter {
 public:
  // A new, empty file; ALREADY_EXISTS if there is one.
  static absl::StatusOr<std::shared_ptr<RecordWriter>> Create(const std::string& path);
  // Goes on after `records` whole records of `bytes` bytes; what follows them is cut off.
  static absl::StatusOr<std::shared_ptr<RecordWriter>> Continue(const std::string& path,
                                                                uint64_t records, uint64_t bytes);
  ~RecordWriter();
  RecordWriter(const RecordWriter&) = delete;
  RecordWriter& operator=(const RecordWriter&) = delete;

  // On failure the file is as it was before; RESOURCE_EXHAUSTED where the disk, a quota or a limit
  // is full. DATA_LOSS: a part of the record could not be taken back; nothing can be appended any
  // more.
  absl::Status Append(std::string_view payload);
  // Returns when everything appended before the call is on the disk. After a failure nobody knows
  // what is: give the writer up and read the file again.
  absl::Status Sync();

  uint64_t records() const { return records_; }
  uint64_t bytes() const { return bytes_; }

 private:
  RecordWriter(std::string path, int fd, uint64_t records, uint64_t bytes)
      : path_(std::move(path)), fd_(fd), records_(records), bytes_(bytes) {}

  const std::string path_;
  const int fd_;
  uint64_t records_, bytes_;
  absl::Status broken_;
};

// What a file holds.
struct RecordExtent {
  uint64_t records = 0;  // whole ones
  uint64_t bytes = 0;    // of them
  bool torn = false;     // followed by the beginning of one that was never finished
};

// Hands the payloads to `take` in order, one in memory at a time; its error ends the reading.
// Trusts nothing. A damaged record is DATA_LOSS, naming file and offset, unless `may_be_torn` and
// no whole record follows it: then it is the end of a write that a crash cut off.
absl::StatusOr<RecordExtent> ReadRecords(const std::string& path, bool may_be_torn,
                                         absl::FunctionRef<absl::Status(std::string_view)> take);
// The same on bytes in memory; `name` is for messages.
absl::StatusOr<RecordExtent> ReadRecordBytes(
    const std::string& name, std::string_view bytes, bool may_be_torn,
    absl::FunctionRef<absl::Status(std::string_view)> take);

// Makes entries of a directory (new and renamed files) durable.
absl::Status SyncDirectory(const std::string& directory);

}  // namespace robostress
