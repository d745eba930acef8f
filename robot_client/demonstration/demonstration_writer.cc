#include "robot_client/demonstration/demonstration_writer.h"

#include <pthread.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/status_macros.h"
#include "robot_client/cameras/jpeg.h"

namespace robostress {
namespace {

constexpr std::chrono::milliseconds kPoll{5};
constexpr int kQuality = 95;

bool Finite(const ArmVector& values) {
  return std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); });
}

}  // namespace

absl::StatusOr<std::unique_ptr<DemonstrationWriter>> DemonstrationWriter::Create(
    DemonstrationOptions options, std::vector<FrameSource*> cameras, const Clock* clock) {
  options.shards = options.shards && !cameras.empty();
  std::vector<std::string> names;
  for (const FrameSource* camera : cameras) names.push_back(camera->name());
  if (options.libero_tool && names.size() != 2) {
    return absl::InvalidArgumentError(
        absl::StrCat("LIBERO's form has two cameras, this client ", names.size(),
                     "; give --camera twice or leave LIBERO's form out"));
  }
  RS_ASSIGN_OR_RETURN(
      LerobotDataset dataset,
      LerobotDataset::Open(options.directory + "/lerobot",
                           LerobotSchemaOf(options.robot, options.axes, options.rate_hz, names)));
  if (options.shards) RS_RETURN_IF_ERROR(MakeDirectories(options.directory + "/shards"));
  if (options.libero_tool) RS_RETURN_IF_ERROR(MakeDirectories(options.directory + "/libero"));
  return std::unique_ptr<DemonstrationWriter>(
      new DemonstrationWriter(std::move(options), std::move(cameras), clock, std::move(dataset)));
}

DemonstrationWriter::DemonstrationWriter(DemonstrationOptions options,
                                         std::vector<FrameSource*> cameras, const Clock* clock,
                                         LerobotDataset dataset)
    : options_(std::move(options)),
      cameras_(std::move(cameras)),
      clock_(clock),
      saved_(dataset.episodes()),
      dataset_(std::move(dataset)) {
  RemoveUnfinished();
  thread_ = std::thread([this] {
    pthread_setname_np(pthread_self(), "demonstration");
    Run();
  });
}

DemonstrationWriter::~DemonstrationWriter() {
  open_ = 0;
  Ask(Order::kQuit).IgnoreError();
  thread_.join();
}

absl::StatusOr<DemonstrationSummary> DemonstrationWriter::Ask(Order order) {
  StdLock lock(mu_);
  order_ = order;
  changed_.notify_all();
  while (order_ != Order::kNone) changed_.wait(lock.waiting());
  return answer_;
}

absl::Status DemonstrationWriter::Begin(const std::string& instruction) {
  if (open_ != 0)
    return absl::FailedPreconditionError("a demonstration is under way; end or discard it first");
  if (instruction.empty())
    return absl::InvalidArgumentError("a demonstration needs an instruction: what is being done");
  uint64_t episode = 0;
  {
    const StdLock lock(mu_);
    instruction_ = instruction;
    episode = ++begun_;
  }
  RS_RETURN_IF_ERROR(Ask(Order::kBegin).status());
  lost_ = 0;
  open_ = episode;
  return absl::OkStatus();
}

bool DemonstrationWriter::Add(const DemonstrationTick& tick) {
  const uint64_t episode = open_.load(std::memory_order_acquire);
  if (episode == 0) return false;
  if (ring_.Push({episode, tick})) return true;
  lost_.fetch_add(1, std::memory_order_relaxed);
  return false;
}

absl::StatusOr<DemonstrationSummary> DemonstrationWriter::End(bool success) {
  if (open_.exchange(0) == 0)
    return absl::FailedPreconditionError("no demonstration is under way; begin one");
  {
    const StdLock lock(mu_);
    success_ = success;
  }
  return Ask(Order::kEnd);
}

absl::Status DemonstrationWriter::Discard() {
  if (open_.exchange(0) == 0)
    return absl::FailedPreconditionError("no demonstration is under way; begin one");
  return Ask(Order::kDiscard).status();
}

void DemonstrationWriter::Clear(uint64_t episode, const std::string& instruction) {
  current_ = episode;
  spoiled_ = absl::OkStatus();
  bytes_ = 0;
  oldest_frame_ns_ = 0;
  episode_ = {};
  episode_.instruction = instruction;
  episode_.axes = options_.axes;
  episode_.rate_hz = options_.rate_hz;
  for (const FrameSource* camera : cameras_) episode_.cameras.push_back(camera->name());
  episode_.jpegs.resize(cameras_.size());
  episode_.small.resize(cameras_.size());
  episode_.width.resize(cameras_.size());
  episode_.height.resize(cameras_.size());
  last_.assign(cameras_.size(), nullptr);
}

// The newest pictures; every camera's, or the reason why there are none.
absl::Status DemonstrationWriter::TakePictures(const DemonstrationTick& tick) {
  for (size_t c = 0; c < cameras_.size(); ++c) {
    const std::shared_ptr<const Frame> frame = cameras_[c]->Latest();
    const int64_t now = clock_->now_ns();
    const std::string camera = absl::StrCat("camera '", cameras_[c]->name(), "'");
    if (frame == nullptr || FromTheFuture(frame->stamp_ns, now) ||
        static_cast<double>(now - frame->stamp_ns) > options_.max_frame_age_s * 1e9) {
      const absl::Status why = cameras_[c]->status();
      return absl::UnavailableError(absl::StrCat(
          camera, " gave no fresh picture: ",
          why.ok() ? absl::StrCat("none for ", options_.max_frame_age_s, " s") : why.message()));
    }
    const Image& image = frame->image;
    int& width = episode_.width[c];
    int& height = episode_.height[c];
    if (width == 0) {
      width = image.width;
      height = image.height;
    }
    if (image.width != width || image.height != height) {
      return absl::DataLossError(absl::StrCat(camera, " changed its size from ", width, " x ",
                                              height, " to ", image.width, " x ", image.height));
    }
    oldest_frame_ns_ = std::max(oldest_frame_ns_, tick.stamp_ns - frame->stamp_ns);
    auto& jpegs = episode_.jpegs[c];
    auto& small = episode_.small[c];
    // A camera that is slower than the ticks shows the same picture twice; encode it once.
    if (frame == last_[c] && !jpegs.empty()) {
      jpegs.push_back(jpegs.back());
      small.push_back(small.back());
    } else {
      RS_ASSIGN_OR_RETURN(std::string jpeg, JpegFromRgb(image, kQuality));
      jpegs.push_back(std::move(jpeg));
      small.push_back(ResizeArea(image, options_.small_side, options_.small_side));
      last_[c] = frame;
    }
    bytes_ += static_cast<double>(jpegs.back().size() + small.back().data.size());
  }
  return absl::OkStatus();
}

void DemonstrationWriter::Take(const Item& item) {
  if (item.episode != current_ || !spoiled_.ok()) return;
  const double seconds = static_cast<double>(episode_.ticks.size()) / options_.rate_hz;
  if (!Finite(item.tick.state) || !Finite(item.tick.action)) {
    spoiled_ = absl::DataLossError("a state or an action is not a finite number");
  } else if (seconds > options_.most_s || bytes_ > options_.most_gb * 1e9) {
    spoiled_ = absl::ResourceExhaustedError(absl::StrFormat(
        "the demonstration passed %g s or %g GB; make it shorter or the pictures smaller",
        options_.most_s, options_.most_gb));
  } else {
    spoiled_ = TakePictures(item.tick);
  }
  if (spoiled_.ok()) episode_.ticks.push_back(item.tick);
}

absl::StatusOr<DemonstrationSummary> DemonstrationWriter::Save(bool success) {
  RS_RETURN_IF_ERROR(spoiled_);
  if (const uint64_t lost = lost_.load(); lost > 0) {
    return absl::ResourceExhaustedError(absl::StrCat(
        lost,
        " ticks were lost because pictures were not encoded in time; use smaller pictures or "
        "fewer cameras"));
  }
  if (episode_.ticks.empty())
    return absl::FailedPreconditionError("the demonstration has no ticks: nothing was saved");
  if (options_.actions_are_next_states) {
    for (size_t i = 0; i < episode_.ticks.size(); ++i)
      episode_.ticks[i].action = episode_.ticks[std::min(i + 1, episode_.ticks.size() - 1)].state;
  }
  episode_.success = success;
  DemonstrationSummary summary;
  summary.episode = dataset_.episodes();
  summary.ticks = static_cast<int64_t>(episode_.ticks.size());
  summary.oldest_frame_ms = static_cast<double>(oldest_frame_ns_) * 1e-6;
  if (!success && !options_.keep_failures) {
    summary.text = absl::StrCat("a failure of ", summary.ticks, " ticks, not kept");
    return summary;
  }
  if (const absl::Status written = WriteFiles(success); !written.ok()) {
    RemoveUnfinished();
    return written;
  }
  saved_ = dataset_.episodes();
  summary.saved = true;
  summary.text = absl::StrFormat("demonstration %d saved (%s): %d ticks, %.1f s", summary.episode,
                                 success ? "success" : "failure", summary.ticks,
                                 static_cast<double>(summary.ticks) / options_.rate_hz);
  absl::StrAppend(&summary.text, cameras_.empty()
                                     ? ", no pictures"
                                     : absl::StrFormat(", %.1f MB, pictures at most %.0f ms old",
                                                       bytes_ / 1e6, summary.oldest_frame_ms));
  return summary;
}

std::string DemonstrationWriter::TrainingFile(const char* folder, const char* ending) const {
  return absl::StrFormat("%s/%s/episode_%06d.%s", options_.directory, folder, dataset_.episodes(),
                         ending);
}

// The data set's last file makes the episode count.
absl::Status DemonstrationWriter::WriteFiles(bool success) {
  if (success && options_.shards) {
    RS_RETURN_IF_ERROR(WriteShard(episode_, dataset_.episodes(), options_.shard_side,
                                  options_.shard_stride, options_.shard_horizon,
                                  TrainingFile("shards", "safetensors")));
  }
  if (success && options_.libero_tool) {
    RS_RETURN_IF_ERROR(
        WriteLiberoEpisode(episode_, options_.libero_tool, TrainingFile("libero", "hdf5")));
  }
  return dataset_.Append(ToLerobot(episode_));
}

// Files of an episode that the data set does not count.
void DemonstrationWriter::RemoveUnfinished() const {
  std::error_code ignored;
  std::filesystem::remove(TrainingFile("shards", "safetensors"), ignored);
  std::filesystem::remove(TrainingFile("libero", "hdf5"), ignored);
}

void DemonstrationWriter::Run() {
  StdLock lock(mu_);
  for (bool quit = false; !quit;) {
    const auto ordered = [this]()
                             ABSL_EXCLUSIVE_LOCKS_REQUIRED(mu_) { return order_ != Order::kNone; };
    if (current_ == 0) {
      changed_.wait(lock.waiting(), ordered);
    } else {
      changed_.wait_for(lock.waiting(), kPoll, ordered);
    }
    const Order order = order_;
    const std::string instruction = instruction_;
    const bool success = success_;
    const uint64_t begun = begun_;
    lock.Unlock();
    absl::StatusOr<DemonstrationSummary> answer = DemonstrationSummary{};
    if (order != Order::kDiscard && order != Order::kQuit) {
      for (Item item; ring_.Pop(item);) Take(item);
    }
    if (order == Order::kBegin) {
      Clear(begun, instruction);
      // A camera that gives nothing is said before somebody moves an arm for a minute.
      const absl::Status fresh = TakePictures({clock_->now_ns(), {}, {}});
      Clear(fresh.ok() ? begun : 0, instruction);
      if (!fresh.ok()) answer = absl::FailedPreconditionError(fresh.message());
    } else if (order == Order::kEnd) {
      answer = Save(success);
      Clear(0, "");
    } else if (order == Order::kDiscard || order == Order::kQuit) {
      Clear(0, "");
      quit = order == Order::kQuit;
    }
    lock.Lock();
    if (order == Order::kNone) continue;
    answer_ = std::move(answer);
    order_ = Order::kNone;
    changed_.notify_all();
  }
}

}  // namespace robostress
