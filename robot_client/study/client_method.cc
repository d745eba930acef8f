#include "robot_client/study/client_method.h"

namespace robostress::piper {
namespace {

bool Follows(const MethodOptions& method) {
  return method.every_step && method.Find<FollowingOptions>() != nullptr;
}

// robostress identify --run RUN, RUN made by piper_residual --profile new --episodes 6 --record
// RUN.
JointResponseOptions ResponseAsDelivered() {
  return {.delay_s = {0.0632, 0.0333, 0.0482, 0.0620, 0.0342, 0.0564},
          .stiffness = {991, 360, 523, 2450, 322, 960},
          .damping = {8.2, 14.0, 14.2, 35.7, 15.5, 10.9},
          .drag = {94.6, 31.3, 42.7, 144, 18.7, 86.7}};
}

}  // namespace

DisturbanceObserverOptions FollowingObserver(Follow follow) {
  return ObserverAround(ResponseAsDelivered(), follow != Follow::kDirect);
}

void UseMethod(const MethodOptions& method, Follow follow, ControlOptions& control) {
  control.observer = method.observer || Follows(method);
  if (Follows(method)) control.disturbance_observer = FollowingObserver(follow);
  control.smoothing = method.smoothing;
  if (method.execute_steps > 0) control.player.execute_steps = method.execute_steps;
}

MethodOptions ServersPart(const MethodOptions& method) {
  MethodOptions rest = method;
  if (Follows(method)) {
    std::get<std::optional<FollowingOptions>>(rest.ways).reset();
    std::get<std::optional<IntegralOptions>>(rest.ways).reset();
    std::get<std::optional<EnvelopeOptions>>(rest.ways).reset();
  }
  rest.observer = rest.every_step = false;
  rest.smoothing = 0;
  rest.execute_steps = 0;
  const bool changed = method.observer || method.every_step || method.execute_steps != 0;
  if (changed) rest.method = rest.adapts() ? "ours" : "base";
  return rest;
}

}  // namespace robostress::piper
