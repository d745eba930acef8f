// That `robostress calibrate` reads what a proxy recorded.
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "calibration/data/measured_log.h"
#include "server/proxy/proxy_record.h"
#include "tests/server/proxy/proxy_messages.h"

namespace robostress {
namespace {

TEST(ProxyLog, IsALogOfCalibrate) {
  const std::string folder = absl::StrCat(::testing::TempDir(), "/proxy-log-", getpid());
  std::filesystem::remove_all(folder);
  ArmProfile profile = JointProfile(1);
  profile.joint_names = {"hinge"};
  {
    auto record = ProxyRecord::Create(folder, profile);
    ASSERT_TRUE(record.ok()) << record.status();
    double q = 0;
    for (int i = 0; i < 400; ++i) {
      const double target = 0.4 * std::sin(0.05 * i) + 0.1 * std::sin(0.31 * i);
      (*record)->Joints(
          1, {{0, Eigen::VectorXd::Constant(1, q), Eigen::VectorXd::Constant(1, target)}});
      q += 0.6 * (target - q);
    }
  }
  calibration::Rig rig;
  rig.rate_hz = profile.rate_hz;
  rig.joints.push_back({.name = "hinge", .input = calibration::JointInput::kPositionTarget});
  calibration::RigLog log;
  log.file = folder + "/joints-1-0.csv";
  const auto read = calibration::ReadMeasuredLog(rig, log);
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(read->rows, 400);
  EXPECT_NEAR(read->dt, 0.05, 1e-9);
  EXPECT_EQ(read->joints[0].command.size(), 400u);
  EXPECT_NEAR(read->joints[0].command[10], 0.4 * std::sin(0.5) + 0.1 * std::sin(3.1), 1e-8);
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace robostress
