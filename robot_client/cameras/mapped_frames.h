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

// Pictures from one process to others on the same machine through a file that both map, best one in
// memory (/dev/shm/NAME). The file holds the newest picture twice over, so that the writer never
// waits for a reader, and a reader never sees half a picture.
//
// File: magic "RSFRAME1", width, height (int32), then two slots of
//   version (uint64, odd while it is written), stamp_ns (int64, CLOCK_MONOTONIC), sequence
//   (uint64), width * height * 3 bytes RGB
class MappedFrameWriter {
 public:
  // Makes `path` anew; readers of an older file keep the older one.
  static absl::StatusOr<std::unique_ptr<MappedFrameWriter>> Create(const std::string& path,
                                                                   int width, int height);
  ~MappedFrameWriter();
  // `image` must have the size of the file. One thread.
  absl::Status Write(const Image& image, int64_t stamp_ns);

 private:
  MappedFrameWriter() = default;
  void* memory_ = nullptr;
  size_t length_ = 0;
  int width_ = 0, height_ = 0;
  uint64_t sequence_ = 0;
};

// The reading end as a camera. The path may appear after Start; a writer that starts anew is found
// again within a second of silence, by Latest.
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
  struct Mapping;
  absl::Status Open();

  const std::string name_, path_;
  const Clock* const clock_;
  // Written by Start and Latest (one thread), read by newest_stamp_ns (any): mappings are kept
  // until the source goes.
  std::atomic<const Mapping*> current_{nullptr};
  std::vector<std::unique_ptr<const Mapping>> mappings_;
  int64_t opened_ns_ = 0;
  std::shared_ptr<const Frame> newest_;
};

}  // namespace robostress
