#pragma once

#include <memory>

#include "absl/types/span.h"
#include "common/joint_errors/effects/joint_effect.h"
#include "common/joint_errors/options.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {

// The paper's four errors as effects of the library, in the order in which they act on a joint.
enum PaperErrorKind { kPaperFriction, kPaperGravity, kPaperBacklash, kPaperCompliance };

// One row: whether a scenario injects it, what makes it stronger, its effect, and how that takes a
// joint's parameters.
struct PaperError {
  bool Scenario::*on;
  double SeverityFactors::*factor;
  EffectStage stage;
  std::unique_ptr<JointEffect> (*make)(const JointErrorOptions&);
  void (*set)(const JointErrorParameters&, const JointErrorOptions&, JointEffect&);
};

absl::Span<const PaperError> PaperErrors();  // by PaperErrorKind

}  // namespace robostress
