#pragma once

#include <memory>

#include "common/joint_errors/effects/joint_effect.h"
#include "common/joint_errors/options.h"

// The forward models, one function per row of effect_library.cc, grouped by stage in a file each.
namespace robostress::effects {

using Maker = std::unique_ptr<JointEffect>();

Maker TransportDelay, ServoLag, RateLimit;                     // command_effects.cc
Maker TorqueSaturation, Deadzone, TimeVaryingGain, MotorGain;  // drive_effects.cc
Maker StribeckFriction, AsymmetricCoulomb, AsymmetricViscous,  // friction_effects.cc
    LoadDependentFriction, GravityDependentFriction, QuadraticViscousFriction, TimeDriftFriction,
    TemperatureFriction, PreslidingHysteresis, PositionDependentFriction, CrossJointFriction,
    CrossJointRubbing;
Maker GravityError, Payload, PositionPeriodicTorque, PositionDependentTorque, CableSpring,
    CrossJointCoupling, CrossJointInertia, BaseTilt;           // load_effects.cc
Maker TransmissionError, BacklashGap, TransmissionCompliance;  // transmission_effects.cc
Maker EncoderGain, EncoderOffset, EncoderEccentricity;         // sensor_effects.cc

// Forms that only the paper's errors take (paper_errors.cc): Stribeck friction without true
// stiction, and a deflection given by K [Nm/rad], M_eff [kg m^2] and D [Nm s/rad].
std::unique_ptr<JointEffect> StribeckFrictionOf(FrictionLaw law, double tanh_width);
Maker ComplianceOfMass;

}  // namespace robostress::effects
