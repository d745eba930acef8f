#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"

namespace robostress {

// Pictures from one process to others on the same machine through a file, best one in memory
// (/dev/shm/NAME). The file holds the newest picture twice over, so that the writer never waits for
// a reader, and a reader never sees half a picture.
//
// File: magic "RSFRAME1", width, height (int32), then two slots of
//   version (uint64, odd while it is written), stamp_ns (int64, CLOCK_MONOTONIC), sequence
//   (uint64), width * height * 3 bytes RGB, zeros up to a multiple of 8
//
// Both ends read and write the file and map nothing: in a mapping, a file that somebody truncates
// or a full disk is a SIGBUS, which kills the process that drives the arm.
class MappedFrameWriter {
 public:
  // Makes `path` anew; readers of an older file keep the older one.
  static absl::StatusOr<std::unique_ptr<MappedFrameWriter>> Create(const std::string& path,
                                                                   int width, int height);
  ~MappedFrameWriter();
  // `image` must have the size of the file. A file that was truncated is whole again after two
  // pictures. One thread.
  absl::Status Write(const Image& image, int64_t stamp_ns);

 private:
  MappedFrameWriter() = default;
  std::string path_;
  int fd_ = -1;
  int width_ = 0, height_ = 0;
  uint64_t sequence_ = 0;
  std::vector<char> slot_;  // as it goes into the file
};

// The reading end as a camera. The path may appear after Start; a writer that starts anew is found
// again within a second of silence, by Latest. While the file is truncated or damaged nothing new
// comes and status() says so; it comes again when the file is whole.
class MappedSource : public FrameSource {
 public:
  MappedSource(std::string name, std::string path, const Clock* clock);
  ~MappedSource() override;

  const std::string& name() const override { return name_; }
  absl::Status Start() override;
  std::shared_ptr<const Frame> Latest() override;
  int64_t newest_stamp_ns() const override;
  absl::Status status() const override;

 private:
  struct Found;
  absl::Status Open();
  Found Find() const;

  const std::string name_, path_;
  const Clock* const clock_;
  // One descriptor for the source's life: a newer file takes its number over (dup3), so that
  // newest_stamp_ns never reads one that was closed. -1 before the first file.
  std::atomic<int> fd_{-1};
  mutable std::atomic<int64_t> stamp_ns_{0};  // of the newest picture that was good
  int64_t opened_ns_ = 0;
  std::shared_ptr<const Frame> newest_;
};

}  // namespace robostress
