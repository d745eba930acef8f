#pragma once

#include "adapter/method_options.h"
#include "robot_client/control/control_options.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// What a Piper's client does of a method by itself, tick by tick: the disturbance observer (dob),
// model following in joint space (every_step: the observer around the response of a healthy arm),
// smoothing, rows per chunk.
void UseMethod(const MethodOptions& method, Follow follow, ControlOptions& control);

// Around the response of the emulated arm `new` as delivered, from which the policy's
// demonstrations are; only its planned mode has servos with an integral part.
DisturbanceObserverOptions FollowingObserver(Follow follow);

// What is left of it for the policy's server.
MethodOptions ServersPart(const MethodOptions& method);

}  // namespace robostress::piper
