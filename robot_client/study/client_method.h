#pragma once

#include "adapter/method_options.h"
#include "robot_client/control/control_options.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// What a Piper's client does of a method by itself, tick by tick: the disturbance observer (dob),
// model following in joint space (every_step: the observer around the response of a healthy arm),
// smoothing, rows per chunk.
void UseMethod(const MethodOptions& method, Follow follow, ControlOptions& control);

// The observer around the response of the emulated arm `new` as delivered, from which the policy's
// demonstrations are. Where the arm's own servos integrate it has to be several times slower than
// they are (0.3 s); impedance controllers do not, and leave it as fast as the delay lets it.
DisturbanceObserverOptions FollowingObserver(Follow follow);

// What is left of it for the policy's server.
MethodOptions ServersPart(const MethodOptions& method);

}  // namespace robostress::piper
