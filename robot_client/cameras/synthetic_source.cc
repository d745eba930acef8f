#include "robot_client/cameras/synthetic_source.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

constexpr int kBits = 32;
constexpr int kStripRows = 8;

uint8_t* PixelOf(Image& image, int row, int col) {
  return image.data.data() + 3 * (static_cast<size_t>(row) * image.width + col);
}

Image Draw(const SyntheticSourceOptions& options, uint64_t sequence) {
  Image image{options.width, options.height, {}};
  image.data.resize(size_t{3} * options.width * options.height);
  const int block = options.width / kBits;
  for (int row = 0; row < options.height; ++row) {
    for (int col = 0; col < options.width; ++col) {
      uint8_t* pixel = PixelOf(image, row, col);
      if (row < kStripRows) {
        const int bit = std::min(col / block, kBits - 1);
        std::fill_n(pixel, 3, (sequence >> bit) & 1 ? 255 : 0);
      } else {
        pixel[0] = static_cast<uint8_t>(col + static_cast<int>(sequence));
        pixel[1] = static_cast<uint8_t>(row);
        pixel[2] = static_cast<uint8_t>((col ^ row) & 0xff);
      }
    }
  }
  return image;
}

}  // namespace

SyntheticSource::SyntheticSource(SyntheticSourceOptions options, const Clock* clock)
    : options_(std::move(options)),
      clock_(clock),
      period_ns_(static_cast<int64_t>(1e9 / options_.rate_hz)),
      age_ns_(static_cast<int64_t>(options_.exposure_age_s * 1e9)) {}

absl::Status SyntheticSource::Start() {
  if (options_.width < 2 * kBits || options_.height < kStripRows || !(options_.rate_hz > 0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("camera '", options_.name, "' is ", options_.width, " x ", options_.height,
                     " at ", options_.rate_hz, " Hz; a synthetic one needs 64 x 8 and a rate"));
  }
  start_ns_ = clock_->now_ns();
  return absl::OkStatus();
}

int64_t SyntheticSource::NewestIndex() const {
  const int64_t since = clock_->now_ns() - age_ns_ - start_ns_;
  return since < 0 ? -1 : since / period_ns_;
}

int64_t SyntheticSource::newest_stamp_ns() const {
  const int64_t index = NewestIndex();
  return index < 0 ? 0 : start_ns_ + index * period_ns_;
}

std::shared_ptr<const Frame> SyntheticSource::Latest() {
  const int64_t index = NewestIndex();
  if (index < 0) return nullptr;
  const auto sequence = static_cast<uint64_t>(index) + 1;
  if (frame_ == nullptr || frame_->sequence != sequence) {
    auto frame = std::make_shared<Frame>();
    frame->image = Draw(options_, sequence);
    frame->stamp_ns = start_ns_ + index * period_ns_;
    frame->sequence = sequence;
    frame_ = std::move(frame);
  }
  return frame_;
}

absl::StatusOr<uint64_t> SequenceIn(const Image& image) {
  if (image.width < 2 * kBits || image.height < kStripRows)
    return absl::DataLossError(
        absl::StrCat("the picture is ", image.width, " x ", image.height, ": no number in it"));
  const int block = image.width / kBits;
  uint64_t sequence = 0;
  for (int bit = 0; bit < kBits; ++bit) {
    const size_t at =
        3 * (static_cast<size_t>(kStripRows / 2) * image.width + bit * block + block / 2);
    const uint8_t value = image.data[at];
    if (value > 64 && value < 192)
      return absl::DataLossError(absl::StrCat("block ", bit, " is ", int{value}, ", grey"));
    if (value >= 192) sequence |= uint64_t{1} << bit;
  }
  return sequence;
}

}  // namespace robostress
