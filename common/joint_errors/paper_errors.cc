#include "common/joint_errors/paper_errors.h"

#include "common/joint_errors/effects/effect_makers.h"

namespace robostress {
namespace {

using Options = JointErrorOptions;
using Parameters = JointErrorParameters;

constexpr PaperError kErrors[] = {
    {&Scenario::friction_on, &SeverityFactors::friction, EffectStage::kJoint,
     [](const Options& o) { return effects::StribeckFrictionOf(o.friction_law, o.tanh_width); },
     [](const Parameters& p, const Options&, JointEffect& effect) {
       effect.SetParameters({p.Fc, p.Fs, p.vs, p.sigma_v});
     }},
    {&Scenario::gravity_on, &SeverityFactors::gravity, EffectStage::kJoint,
     [](const Options&) { return effects::GravityError(); },
     [](const Parameters& p, const Options& o, JointEffect& effect) {
       effect.SetParameters({o.gravity_sign == GravitySign::kLiteral ? p.beta : -p.beta});
     }},
    {&Scenario::backlash_on, &SeverityFactors::backlash, EffectStage::kTransmission,
     [](const Options&) { return effects::BacklashGap(); },
     [](const Parameters& p, const Options&, JointEffect& effect) { effect.SetParameters({p.B}); }},
    {&Scenario::compliance_on, &SeverityFactors::compliance, EffectStage::kTransmission,
     [](const Options&) { return effects::ComplianceOfMass(); },
     [](const Parameters& p, const Options&, JointEffect& effect) {
       effect.SetParameters({p.K, p.M_eff, p.D});
     }},
};

}  // namespace

absl::Span<const PaperError> PaperErrors() { return kErrors; }

}  // namespace robostress
