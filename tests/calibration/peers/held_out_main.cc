// calibration_held_out: the held-out error of a rig's models as they stand, by the rig's own
// metric, so that models from other programs are compared on the same ground.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <string>

#include "calibration/search/aided_motion.h"
#include "calibration/search/joint_case.h"
#include "common/command_line.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {
namespace {

// One line a joint: name, error on what `calibrate` reports of logs that are held out, on those
// that are fitted [rad or m; Nm of input inverse]. What a row leaves open (command_shift,
// force_lag) is fitted, and nothing that the rig says.
absl::Status Run(const std::string& file) {
  RS_ASSIGN_OR_RETURN(LoadedRig loaded, LoadRig(file));
  for (RigJoint& joint : loaded.rig.joints) {
    joint.fit.clear();
    for (DeclaredEffect& effect : joint.effects) effect.fit.clear();
  }
  if (!loaded.plant->single())
    RS_RETURN_IF_ERROR(AidArmMotions(loaded.rig, *loaded.plant, loaded.logs));
  for (int i = 0; i < static_cast<int>(loaded.rig.joints.size()); ++i) {
    JointCase joint(loaded.rig, *loaded.plant, loaded.logs, i);
    RS_ASSIGN_OR_RETURN(const Hypothesis declared, loaded.Declared(i));
    joint.problem.LinearizeStarts(declared.model);
    const Hypothesis best = Minimise(joint.problem, declared, joint.Fit()).best;
    const JointModel model = ModelAt(best, best.x);
    std::printf("%s %.9g %.9g\n", joint.declared().name.c_str(),
                joint.metric.Error(model, joint.Sealed()),
                joint.metric.Error(model, LogRole::kFit));
  }
  return absl::OkStatus();
}

int Main(int argc, char** argv) {
  std::string rig;
  cli::App app("The held-out error of a rig's models as they stand", "calibration_held_out");
  app.add_option("--rig", rig, "Rig file")->required();
  return RunMain(app, argc, argv, [&] { return Run(rig); });
}

}  // namespace
}  // namespace robostress::calibration

int main(int argc, char** argv) { return robostress::calibration::Main(argc, argv); }
