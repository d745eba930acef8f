#pragma once

namespace robostress {

enum class FrictionLaw { kSgn, kTanh, kStick };
enum class OffsetMode { kTeleport, kVelocity };
enum class OffsetStart { kZero, kEquilibrium };
enum class GravitySign { kLiteral, kPayload };

// How the joint error laws are discretised; the defaults are the paper's text taken literally.
struct JointErrorOptions {
  FrictionLaw friction_law = FrictionLaw::kSgn;
  double tanh_width = 0.01;  // [rad/s]
  OffsetMode offset_mode = OffsetMode::kTeleport;
  OffsetStart offset_start = OffsetStart::kZero;
  GravitySign gravity_sign = GravitySign::kLiteral;

  template <class V>
  void Visit(V& v) {
    v.Choice(
        "friction_law", friction_law,
        {{"sgn", FrictionLaw::kSgn}, {"tanh", FrictionLaw::kTanh}, {"stick", FrictionLaw::kStick}},
        "sgn: the paper's law; tanh: smoothed over tanh_width; stick: true stiction within a "
        "sub-step");
    v.Field("tanh_width", tanh_width, "velocity scale of the tanh law [rad/s]");
    v.Choice("offset_mode", offset_mode,
             {{"teleport", OffsetMode::kTeleport}, {"velocity", OffsetMode::kVelocity}},
             "teleport: add the offset's change to the joint position; velocity: as a one-sub-step "
             "velocity, "
             "which contact friction sees");
    v.Choice("offset_start", offset_start,
             {{"zero", OffsetStart::kZero}, {"equilibrium", OffsetStart::kEquilibrium}},
             "compliance deflection at the start of an episode");
    v.Choice("gravity_sign", gravity_sign,
             {{"literal", GravitySign::kLiteral}, {"payload", GravitySign::kPayload}},
             "literal: +beta g lifts the arm; payload: -beta g lets it sag");
  }
};

}  // namespace robostress
