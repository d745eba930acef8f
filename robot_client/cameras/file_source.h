#pragma once

#include <memory>
#include <string>
#include <vector>

#include "common/clock.h"
#include "robot_client/cameras/frame_source.h"

namespace robostress {

struct FileSourceOptions {
  std::string name;
  std::string directory;  // *.ppm, played in the order of their names
  double rate_hz = 30;
  bool loop = true;  // false: after the last picture none comes, as from a camera that stops
};

// A camera that plays pictures from a folder at a constant rate.
class FileSource : public FrameSource {
 public:
  FileSource(FileSourceOptions options, const Clock* clock);

  const std::string& name() const override { return options_.name; }
  absl::Status Start() override;  // reads every picture; NOT_FOUND when there is none
  std::shared_ptr<const Frame> Latest() override;
  int64_t newest_stamp_ns() const override;
  absl::Status status() const override;

 private:
  int64_t NewestIndex() const;  // counts on through loops

  const FileSourceOptions options_;
  const Clock* const clock_;
  const int64_t period_ns_;
  std::vector<Image> pictures_;
  int64_t start_ns_ = 0;
};

}  // namespace robostress
