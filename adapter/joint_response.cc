#include "adapter/joint_response.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "common/check.h"

namespace robostress {
namespace {

constexpr double kStep_s = 0.001;

absl::Status CheckValues(const char* key, const std::vector<double>& values, int joints, double low,
                         double high) {
  if (values.size() != 1 && static_cast<int>(values.size()) != joints)
    return absl::InvalidArgumentError(
        absl::StrCat("response.", key, " has ", values.size(), " values, must have 1 or ", joints));
  for (const double value : values)
    if (!(value >= low && value <= high))
      return absl::InvalidArgumentError(
          absl::StrCat("response.", key, " has ", value, ", must be ", low, " to ", high));
  return absl::OkStatus();
}

}  // namespace

absl::Status JointResponseOptions::Check(int joints) const {
  if (!on()) {
    if (stiffness.empty() && damping.empty() && drag.empty()) return absl::OkStatus();
    return absl::InvalidArgumentError(
        "response.delay_s is empty, so stiffness, damping and drag would change nothing; give it, "
        "0 where there is no delay");
  }
  absl::Status status = CheckValues("delay_s", delay_s, joints, 0, JointResponse::kMaxDelay_s);
  status.Update(CheckValues("stiffness", stiffness, joints, 1, 1e5));
  status.Update(CheckValues("damping", damping, joints, 0, 1e4));
  status.Update(CheckValues("drag", drag, joints, 0, 1e4));
  return status;
}

void JointResponse::Reset(const Joints& q) {
  q_ = q;
  v_ = Joints::Zero(q.size());
  now_s_ = 0;
  newest_ = 0;
  count_ = 1;
  sent_[0].begin_s = -kMaxDelay_s;
  sent_[0].target = q;
}

void JointResponse::Advance(const Joints& target, double dt_s) {
  RS_CHECK(target.size() == q_.size());
  if (!(dt_s > 0)) return;
  newest_ = (newest_ + 1) % kHistory;
  count_ = std::min(count_ + 1, kHistory);
  sent_[newest_].begin_s = now_s_;
  sent_[newest_].target = target;
  const int steps = std::max(1, static_cast<int>(std::ceil(dt_s / kStep_s - 1e-9)));
  const double h = dt_s / steps;
  for (Eigen::Index j = 0; j < q_.size(); ++j) {
    const double delay = Of(options_.delay_s, j), k = Of(options_.stiffness, j);
    const double b = Of(options_.damping, j), c = Of(options_.drag, j);
    int back = 0;  // of the target in force, from the newest
    const auto entry = [&] { return (newest_ + kHistory - back) % kHistory; };
    while (back + 1 < count_ && sent_[entry()].begin_s > now_s_ - delay) ++back;
    for (int i = 0; i < steps; ++i) {
      const double due = now_s_ + i * h - delay + 1e-9;
      while (back > 0 && sent_[(entry() + 1) % kHistory].begin_s <= due) --back;
      v_[j] = (v_[j] + h * k * (sent_[entry()].target[j] - q_[j])) /
              (1 + h * b + h * c * std::abs(v_[j]));
      q_[j] += h * v_[j];
    }
  }
  now_s_ += dt_s;
}

}  // namespace robostress
