#include "calibration/data/recording_statistics.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/match.h"

namespace robostress::calibration {
namespace {

constexpr int kBinsPerOctave = 32;
constexpr int kBins = 48 * kBinsPerOctave;  // up to 2^48 ns, three days
constexpr size_t kMostNotes = 200;
constexpr size_t kMostSets = 64;  // of names in one channel's messages
constexpr size_t kMostSetsOfAll = 1024, kMostCompared = 256;
constexpr size_t kMostValues = 1024;
constexpr size_t kMostAlike = 64;  // positions that a command without a name is compared with
constexpr double kTurn = 0.02;     // of the span: a motion back by less is no reversal

int BinOf(int64_t step_ns) {
  return std::clamp(static_cast<int>(std::log2(static_cast<double>(step_ns)) * kBinsPerOctave), 0,
                    kBins - 1);
}

}  // namespace

void StepCounts::Add(int64_t tick, bool first) {
  if (ticks_++ == 0) first_ = tick;
  const int64_t step = first ? 0 : tick - last_;
  last_ = tick;
  if (first) return;
  if (step < 0) ++backwards_;
  if (step == 0) ++duplicates_;
  if (step <= 0) return;
  if (bins_.empty()) bins_.resize(kBins);
  Bin& bin = bins_[static_cast<size_t>(BinOf(step))];
  ++bin.count;
  bin.sum += static_cast<double>(step);
  ++steps_;
  total_s_ += static_cast<double>(step) * 1e-9;
  if (step > longest_) {
    longest_ = step;
    longest_at_ = tick - step - first_;
  }
}

double StepCounts::Quantile(double share) const {
  int64_t below = 0;
  for (const Bin& bin : bins_) {
    below += bin.count;
    if (bin.count > 0 && static_cast<double>(below) >= share * static_cast<double>(steps_))
      return bin.sum / static_cast<double>(bin.count) * 1e-9;
  }
  return 0;
}

double StepCounts::MeanBetween(double least_s, double most_s, int64_t* count) const {
  double sum = 0;
  *count = 0;
  for (const Bin& bin : bins_) {
    const double mean = bin.count > 0 ? bin.sum / static_cast<double>(bin.count) * 1e-9 : 0;
    if (bin.count == 0 || mean < least_s || mean > most_s) continue;
    sum += bin.sum * 1e-9;
    *count += bin.count;
  }
  return *count > 0 ? sum / static_cast<double>(*count) : 0;
}

double StepCounts::Typical() const {
  const double median = Quantile(0.5);
  int64_t count = 0;
  const double near = MeanBetween(0.5 * median, 1.5 * median, &count);
  return 2 * count > steps_ ? near : MeanBetween(0, kGapRows * median, &count);
}

void ValueSample::Add(double value) {
  if (left_-- > 0) return;
  left_ = every_ - 1;
  values_.push_back(value);
  if (values_.size() < kMostValues) return;
  for (size_t i = 0; 2 * i < values_.size(); ++i) values_[i] = values_[2 * i];
  values_.resize(kMostValues / 2);
  every_ *= 2;
  left_ = every_ - 1;
}

double ValueSample::Quantile(double share) const {
  if (values_.empty()) return 0;
  std::vector<double> sorted = values_;
  const auto at =
      sorted.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(sorted.size() - 1));
  std::nth_element(sorted.begin(), at, sorted.end());
  return *at;
}

int64_t StepCounts::LongerThan(double limit_s) const {
  int64_t count = 0;
  for (const Bin& bin : bins_) {
    if (bin.count > 0 && bin.sum / static_cast<double>(bin.count) * 1e-9 > limit_s)
      count += bin.count;
  }
  return count;
}

void RecordingStatistics::OnChannel(size_t channel, const RecordedChannel& description) {
  channels_.resize(std::max(channels_.size(), channel + 1));
  last_episode_.resize(channels_.size(), -1);
  channels_[channel].description = description;
}

void RecordingStatistics::OnSignal(size_t signal, const RecordedSignal& description) {
  signals_.resize(std::max(signals_.size(), signal + 1));
  last_.resize(signals_.size());
  signals_[signal].description = description;
  if (description.quantity != JointQuantity::kPosition) return;
  std::vector<size_t>& named = positions_[description.joint];
  if (named.size() < kMostAlike) named.push_back(signal);
  if (all_positions_.size() < kMostAlike) all_positions_.push_back(signal);
}

void RecordingStatistics::OnEpisode(const std::string&) { ++episodes_; }

void RecordingStatistics::OnNote(const std::string& note) {
  if (notes_.size() < kMostNotes)
    notes_.push_back(note);
  else
    ++notes_left_out_;
}

int RecordingStatistics::Find(size_t channel, const std::string& joint,
                              JointQuantity quantity) const {
  for (size_t i = 0; i < signals_.size(); ++i) {
    const RecordedSignal& signal = signals_[i].description;
    if (signal.channel == channel && signal.joint == joint && signal.quantity == quantity)
      return static_cast<int>(i);
  }
  return -1;
}

void RecordingStatistics::TakeReversal(SignalStatistics* signal, Last* last, double value) {
  if (last->direction == 0) last->direction = value > last->turn ? 1 : value < last->turn ? -1 : 0;
  if ((value - last->turn) * last->direction >= 0) {
    last->turn = value;
  } else if (std::abs(value - last->turn) > kTurn * signal->span()) {
    ++signal->reversals;
    last->direction = -last->direction;
    last->turn = value;
  }
}

void RecordingStatistics::TakeValue(const SignalValue& value, int64_t at_ns) {
  SignalStatistics& signal = signals_[value.signal];
  ++signal.count;
  if (!std::isfinite(value.value)) {
    ++signal.not_finite;
    return;
  }
  const bool first = signal.count - signal.not_finite == 1;
  signal.low = first ? value.value : std::min(signal.low, value.value);
  signal.high = first ? value.value : std::max(signal.high, value.value);
  signal.whole = signal.whole && value.value == std::floor(value.value);
  Last& last = last_[value.signal];
  if (last.episode == episodes_ && at_ns > last.at_ns) {
    const double seconds = static_cast<double>(at_ns - last.at_ns) * 1e-9;
    signal.fastest = std::max(signal.fastest, std::abs(value.value - last.value) / seconds);
    TakeReversal(&signal, &last, value.value);
  } else if (last.episode != episodes_) {
    last.turn = value.value;
    last.direction = 0;
  }
  last.value = value.value;
  last.at_ns = at_ns;
  last.episode = episodes_;
}

// With the mean of two rows' velocities, as the derivative is the mean over the time between.
void RecordingStatistics::CompareVelocity(const JointRow& row,
                                          const std::map<std::string, double>& derivative) {
  for (const SignalValue& value : row.values) {
    SignalStatistics& signal = signals_[value.signal];
    const auto found = derivative.find(signal.description.joint);
    if (signal.description.quantity != JointQuantity::kVelocity || found == derivative.end())
      continue;
    const double mean = 0.5 * (value.value + last_[value.signal].value);
    if (!std::isfinite(mean)) continue;
    signal.along += mean * found->second;
    signal.square += found->second * found->second;
  }
}

void RecordingStatistics::CompareCommand(size_t index, double value) {
  SignalStatistics& signal = signals_[index];
  const std::string& joint = signal.description.joint;
  const bool unnamed = absl::StartsWith(joint, "[");
  const auto named = positions_.find(joint);
  if (!unnamed && named == positions_.end()) return;
  for (const size_t position : unnamed ? all_positions_ : named->second) {
    if (last_[position].episode != episodes_) continue;
    auto& [sum, count] = signal.off[position];
    sum += std::pow(value - last_[position].value, 2);
    ++count;
  }
}

void RecordingStatistics::TakePositionSet(const JointRow& row, std::vector<size_t> set) {
  ChannelStatistics& channel = channels_[row.channel];
  std::sort(set.begin(), set.end());
  auto found = channel.position_sets.find(set);
  if (found == channel.position_sets.end()) {
    if (channel.position_sets.size() >= kMostSets || sets_ >= kMostSetsOfAll) return;
    ++sets_;
    found = channel.position_sets.emplace(std::move(set), PositionSet()).first;
  }
  PositionSet& rows = found->second;
  const bool first = rows.episode != episodes_;
  rows.episode = episodes_;
  ++rows.rows;
  rows.log.Add(row.log_ns, first);
  if (!row.stamped) return;
  rows.stamp.Add(row.stamp_ns, first || rows.stamped == 0);
  ++rows.stamped;
  ahead_of_log_[row.channel] = row.stamp_ns - row.log_ns;
}

void RecordingStatistics::CompareClocks(const JointRow& row) {
  ChannelStatistics& channel = channels_[row.channel];
  for (const auto& [positions, ahead] : ahead_of_log_) {
    if (positions == row.channel) continue;
    if (channel.ahead.count(positions) == 0 && compared_++ >= kMostCompared) continue;
    channel.ahead[positions].Add(static_cast<double>(row.stamp_ns - row.log_ns - ahead) * 1e-9);
  }
}

absl::Status RecordingStatistics::OnRow(const JointRow& row) {
  ChannelStatistics& channel = channels_[row.channel];
  const bool first = last_episode_[row.channel] != episodes_;
  last_episode_[row.channel] = episodes_;
  ++channel.rows;
  channel.log.Add(row.log_ns, first);
  if (row.stamped) channel.stamp.Add(row.stamp_ns, first || channel.stamped == 0);
  channel.stamped += row.stamped;
  std::map<std::string, double> derivative;
  std::vector<size_t> set;
  for (const SignalValue& value : row.values) {
    const RecordedSignal& signal = signals_[value.signal].description;
    if (signal.quantity != JointQuantity::kPosition) continue;
    set.push_back(value.signal);
    const Last& last = last_[value.signal];
    if (last.episode == episodes_ && row.stamp_ns > last.at_ns && std::isfinite(value.value))
      derivative[signal.joint] =
          (value.value - last.value) / (static_cast<double>(row.stamp_ns - last.at_ns) * 1e-9);
  }
  if (!set.empty()) TakePositionSet(row, std::move(set));
  CompareVelocity(row, derivative);
  for (const SignalValue& value : row.values) TakeValue(value, row.stamp_ns);
  bool asks = false;
  for (const SignalValue& value : row.values) {
    if (signals_[value.signal].description.quantity != JointQuantity::kCommand ||
        !std::isfinite(value.value))
      continue;
    asks = true;
    CompareCommand(value.signal, value.value);
  }
  if (asks && row.stamped) CompareClocks(row);
  return absl::OkStatus();
}

}  // namespace robostress::calibration
