// Two clients of a proxy that drive one arm, each of which is taken for a robot of its own.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iostream>
#include <string>

#include "server/proxy/action_block.h"
#include "server/proxy/proxied_arm.h"
#include "tests/server/proxy/proxy_messages.h"
#include "tests/server/proxy/rubbing_arm.h"

namespace robostress {
namespace {

struct SharedRun {
  double error = 0;       // from the goal at the end [command units]
  double correction = 0;  // the greatest of any answer
  int doubts = 0;
};

// They take turns; both lead the arm to the same point.
SharedRun TakeTurns(ProxyMode mode, double friction) {
  const ArmProfile profile = LiberoProfile();
  std::array<ProxiedArm, 2> proxies = {ProxiedArm(profile, *MethodOf(profile)),
                                       ProxiedArm(profile, *MethodOf(profile))};
  RubbingArm arm(friction);
  const Eigen::Vector3d goal(3, -2, 0);
  SharedRun run;
  for (int turn = 0; turn < 120; ++turn) {
    ProxiedArm& proxy = proxies[static_cast<size_t>(turn % 2)];
    const Eigen::Vector3d wish = (0.5 * (goal - arm.x())).cwiseMax(-1).cwiseMin(1);
    proxy.Observed(LiberoObservation(arm.state()), false, 0, mode);
    const std::string own = ActionAnswer({wish[0], wish[1], wish[2], 0, 0, 0, -1});
    const std::string sent = proxy.Answered(own, false, 0, mode).value_or(own);
    run.doubts += proxy.report().doubt.has_value();
    const Eigen::MatrixXd actions = ReadActions(sent, *FindActions(sent));
    run.correction = std::max(
        run.correction, (actions - ReadActions(own, *FindActions(own))).cwiseAbs().maxCoeff());
    for (int k = 0; k < profile.execute_steps; ++k) arm.Step(actions.row(k).head<3>().transpose());
  }
  run.error = (goal - arm.x()).norm();
  return run;
}

TEST(SharedArm, IsDrivenWithinTheLimitsAndNoFurtherFromItsGoal) {
  for (const double friction : {0., 60.}) {
    const SharedRun direct = TakeTurns(ProxyMode::kOff, friction),
                    shared = TakeTurns(ProxyMode::kOn, friction);
    std::cout << "friction " << friction << ": direct " << direct.error << ", shared "
              << shared.error << ", greatest correction " << shared.correction << ", doubts "
              << shared.doubts << "\n";
    EXPECT_LE(shared.correction, 0.5 + 1e-6);
    EXPECT_LT(shared.error, direct.error + 0.1);
  }
}

}  // namespace
}  // namespace robostress
