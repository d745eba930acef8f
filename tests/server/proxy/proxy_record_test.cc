#include "server/proxy/proxy_record.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>

#include <chrono>
#include <cmath>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <thread>

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

// Files of this process may not grow beyond so many bytes, while it lives: a disk that is full.
class FullDisk {
 public:
  explicit FullDisk(rlim_t bytes) : handler_(signal(SIGXFSZ, SIG_IGN)) {
    getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{bytes, before_.rlim_max};
    setrlimit(RLIMIT_FSIZE, &limit);
  }
  ~FullDisk() {
    setrlimit(RLIMIT_FSIZE, &before_);
    signal(SIGXFSZ, handler_);
  }

 private:
  rlimit before_{};
  const sighandler_t handler_;
};

std::string Contents(const std::string& file) {
  std::ifstream stream(file);
  return {std::istreambuf_iterator<char>(stream), {}};
}

TEST_F(ProxyFolder, AFullDiskEndsTheRecordWithAWholeRowAndNothingElse) {
  ArmProfile profile = JointProfile(1);
  profile.execute_steps = 1;
  profile.method = "base";
  Metrics metrics;
  int answered = 0;
  {
    auto record = ProxyRecord::Create(folder_, profile);
    ASSERT_TRUE(record.ok()) << record.status();
    ProxyBoard board(profile, *MethodOf(profile), false, &metrics, record->get());
    const auto tap = board.Tap("one");
    const auto ask_ten_times = [&tap] {
      for (int i = 0; i < 10; ++i) Sway(*tap, 1);  // it rests
    };
    const FullDisk full(3000);
    for (int i = 0; i < 2000 && board.record_failure().empty(); ++i, ++answered) {
      ask_ten_times();
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    EXPECT_THAT(board.record_failure(), HasSubstr("File too large"));
    EXPECT_THAT(board.record_failure(), HasSubstr(folder_));
    const uint64_t dropped = (*record)->dropped();
    ask_ten_times();  // it is served on
    EXPECT_EQ((*record)->dropped(), dropped + 20);
    EXPECT_EQ(board.Views()[0].outcomes[static_cast<size_t>(AnswerOutcome::kZero)],
              static_cast<uint64_t>(10 * answered + 10));
  }
  for (const char* file : {"/residuals.csv", "/joints-1-0.csv"}) {
    const std::string text = Contents(folder_ + file);
    ASSERT_FALSE(text.empty()) << file;
    EXPECT_EQ(text.back(), '\n') << file;
    EXPECT_LE(text.size(), 3000u);
    const auto table = CsvTable::Read(folder_ + file);
    ASSERT_TRUE(table.ok()) << table.status();
    EXPECT_GT(table->rows(), 10u) << file;
  }
}

TEST_F(ProxyFolder, AFolderThatCannotBeWrittenIsNamed) {
  std::ofstream(folder_) << "a file";
  const auto refused = ProxyRecord::Create(folder_, JointProfile(1));
  EXPECT_THAT(std::string(refused.status().message()), HasSubstr(folder_));
  const auto nowhere = ProxyRecord::Create("/proc/record", JointProfile(1));
  EXPECT_THAT(std::string(nowhere.status().message()), HasSubstr("/proc/record"));
}

// It goes while the proxy runs: the next stretch cannot be begun.
TEST_F(ProxyFolder, AFolderThatGoesEndsTheRecordAndSaysSo) {
  ArmProfile profile = JointProfile(1);
  profile.execute_steps = 1;
  profile.method = "base";
  Metrics metrics;
  auto record = ProxyRecord::Create(folder_, profile);
  ASSERT_TRUE(record.ok()) << record.status();
  ProxyBoard board(profile, *MethodOf(profile), false, &metrics, record->get());
  std::filesystem::remove_all(folder_);
  const auto tap = board.Tap("one");
  for (int i = 0; i < 1000 && board.record_failure().empty(); ++i) {
    Sway(*tap, 3);
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_THAT(board.record_failure(), HasSubstr("joints-1-0.csv: No such file"));
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
