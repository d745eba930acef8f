#include "robot_client/cameras/file_source.h"

#include <algorithm>
#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "robot_client/cameras/pixel_formats.h"

namespace robostress {
namespace {
constexpr uint64_t kMaxFileBytes = 64 << 20;
}  // namespace

FileSource::FileSource(FileSourceOptions options, const Clock* clock)
    : options_(std::move(options)),
      clock_(clock),
      period_ns_(static_cast<int64_t>(1e9 / options_.rate_hz)) {}

absl::Status FileSource::Start() {
  if (!(options_.rate_hz > 0 && options_.rate_hz <= 1000))
    return absl::InvalidArgumentError(absl::StrCat("camera '", options_.name, "': rate is ",
                                                   options_.rate_hz, " Hz, must be above 0"));
  std::error_code error;
  std::vector<std::string> files;
  for (const auto& entry : std::filesystem::directory_iterator(options_.directory, error)) {
    if (entry.path().extension() == ".ppm") files.push_back(entry.path().string());
  }
  if (files.empty()) {
    return absl::NotFoundError(absl::StrCat("camera '", options_.name, "': ", options_.directory,
                                            " holds no *.ppm", error ? ": " : "",
                                            error ? error.message() : ""));
  }
  std::sort(files.begin(), files.end());
  for (const std::string& file : files) {
    RS_ASSIGN_OR_RETURN(const std::string bytes, ReadFileUpTo(file, kMaxFileBytes));
    RS_ASSIGN_OR_RETURN(Image image, ParsePpm(file, bytes));
    pictures_.push_back(std::move(image));
  }
  start_ns_ = clock_->now_ns();
  return absl::OkStatus();
}

int64_t FileSource::NewestIndex() const {
  const int64_t index = (clock_->now_ns() - start_ns_) / period_ns_;
  return options_.loop ? index : std::min(index, static_cast<int64_t>(pictures_.size()) - 1);
}

int64_t FileSource::newest_stamp_ns() const {
  return pictures_.empty() ? 0 : start_ns_ + NewestIndex() * period_ns_;
}

std::shared_ptr<const Frame> FileSource::Latest() {
  if (pictures_.empty()) return nullptr;
  const int64_t index = NewestIndex();
  auto frame = std::make_shared<Frame>();
  frame->image = pictures_[static_cast<size_t>(index) % pictures_.size()];
  frame->stamp_ns = start_ns_ + index * period_ns_;
  frame->sequence = static_cast<uint64_t>(index) + 1;
  return frame;
}

absl::Status FileSource::status() const {
  if (options_.loop ||
      (clock_->now_ns() - start_ns_) / period_ns_ < static_cast<int64_t>(pictures_.size()))
    return absl::OkStatus();
  return absl::OutOfRangeError(absl::StrCat("camera '", options_.name, "': all ", pictures_.size(),
                                            " pictures of ", options_.directory, " were played"));
}

}  // namespace robostress
