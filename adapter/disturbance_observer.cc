#include "adapter/disturbance_observer.h"

#include <algorithm>
#include <cmath>

#include "common/check.h"

namespace robostress {

void DisturbanceObserver::Reset() {
  z_.resize(0);
  last_target_.resize(0);
  response_.Clear();
  ahead_s_ = 0;
}

const DisturbanceObserver::Joints& DisturbanceObserver::Nominal(const Joints& q, double dt_s) {
  if (!options_.response.on()) return last_target_;
  if (response_.position().size() != q.size()) response_.Reset(q);
  response_.Advance(last_target_, std::max(0.0, dt_s - ahead_s_));
  ahead_s_ = 0;
  return response_.position();
}

DisturbanceObserver::Joints DisturbanceObserver::Correct(const Joints& q_ref, const Joints& q,
                                                         double dt_s) {
  RS_CHECK(q_ref.size() == q.size() && (z_.size() == 0 || z_.size() == q.size()));
  if (z_.size() == 0) {
    z_ = Joints::Zero(q.size());
    if (options_.response.on()) response_.Reset(q);
  } else {
    const double dt = std::clamp(dt_s, options_.min_dt_s, options_.max_dt_s);
    z_ += (1 - std::exp(-options_.bandwidth * dt)) * (q - Nominal(q, dt) - z_);
    if (options_.anti_windup)
      z_ = z_.cwiseMax(-options_.max_correction).cwiseMin(options_.max_correction);
  }
  return CorrectUnmeasured(q_ref);
}

DisturbanceObserver::Joints DisturbanceObserver::CorrectUnmeasured(const Joints& q_ref,
                                                                   double dt_s) {
  if (z_.size() == 0) z_ = Joints::Zero(q_ref.size());
  if (dt_s > 0 && response_.position().size() == q_ref.size() && last_target_.size() > 0) {
    response_.Advance(last_target_, dt_s);
    ahead_s_ += dt_s;
  }
  last_target_ = q_ref - z_.cwiseMax(-options_.max_correction).cwiseMin(options_.max_correction);
  return last_target_;
}

void DisturbanceObserver::Applied(const Joints& sent) {
  RS_CHECK(sent.size() == z_.size());
  last_target_ = sent;
}

}  // namespace robostress
