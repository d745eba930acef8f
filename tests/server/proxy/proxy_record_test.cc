#include "server/proxy/proxy_record.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "absl/strings/str_cat.h"
#include "common/csv_table.h"
#include "server/proxy/proxy_board.h"
#include "tests/server/proxy/proxy_messages.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class ProxyFolder : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = absl::StrCat(::testing::TempDir(), "/proxy-record-", getpid());
    std::filesystem::remove_all(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  std::string folder_;
};

// One joint that lags behind a swaying target, shown at every step.
void Sway(RelayTap& tap, int steps) {
  double q = 0;
  for (int i = 0; i < steps; ++i) {
    tap.FromClient(JointObservation({q, 0}), false);
    const std::string own = ActionAnswer<double>({0.4 * std::sin(0.2 * i), 0}, 1);
    const std::string sent = tap.FromServer(own, false).value_or(own);
    q += 0.6 * (0.4 * std::sin(0.2 * i) - q);
  }
}

TEST_F(ProxyFolder, HoldsEveryStepOfAJointAsCalibrateReadsIt) {
  ArmProfile profile = JointProfile(1);
  profile.execute_steps = 1;
  profile.joint_names = {"hinge"};
  profile.method = "base";
  Metrics metrics;
  {
    auto record = ProxyRecord::Create(folder_, profile);
    ASSERT_TRUE(record.ok()) << record.status();
    ProxyBoard board(profile, *MethodOf(profile), false, &metrics, record->get());
    Sway(*board.Tap("one"), 201);
    Sway(*board.Tap("two"), 61);
    EXPECT_EQ(ProxyRecord::Create(folder_, profile).status().code(),
              absl::StatusCode::kAlreadyExists);
  }
  const auto log = CsvTable::Read(folder_ + "/joints-1-0.csv");
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_EQ(log->names(), (std::vector<std::string>{"t", "q_hinge", "q_cmd_hinge"}));
  ASSERT_EQ(log->rows(), 200u) << "the last step's end was not seen";
  EXPECT_DOUBLE_EQ(*log->Number(3, 0), 0.15);
  EXPECT_NEAR(*log->Number(3, 2), 0.4 * std::sin(0.6), 1e-8);
  // A row is where the joint was when it was told.
  for (size_t i = 0; i + 1 < log->rows(); ++i) {
    const double q = *log->Number(i, 1), target = *log->Number(i, 2);
    EXPECT_NEAR(*log->Number(i + 1, 1), q + 0.6 * (target - q), 1e-7);
  }
  EXPECT_EQ(CsvTable::Read(folder_ + "/joints-2-0.csv")->rows(), 60u);
  const auto answers = CsvTable::Read(folder_ + "/residuals.csv");
  ASSERT_TRUE(answers.ok()) << answers.status();
  EXPECT_EQ(answers->rows(), 262u);
}

TEST_F(ProxyFolder, ForgetsClientsThatAreGone) {
  const ArmProfile profile = JointProfile(1);
  Metrics metrics;
  ProxyBoard board(profile, *MethodOf(profile), false, &metrics, nullptr);
  const auto open = board.Tap("open");
  for (int i = 0; i < 100; ++i) Sway(*board.Tap(absl::StrCat("gone ", i)), 3);
  const auto views = board.Views();
  EXPECT_EQ(views.size(), 1 + ProxyBoard::kGoneClients);
  EXPECT_EQ(views.front().peer, "open");
  EXPECT_TRUE(views.front().open);
  EXPECT_FALSE(views.back().open);
  EXPECT_THAT(metrics.Text(), HasSubstr("robostress_proxy_answers_total"));
}

}  // namespace
}  // namespace robostress
