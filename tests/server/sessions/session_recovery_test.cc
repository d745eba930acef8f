// A session's journal is read by the record: memory is what the state needs, however long it is.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/rpc/convert_specs.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/session_events.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/read_spec.h"
#include "tests/run_program.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// The fake policy with a camera of 640 x 480, 0.9 MiB a view.
class SeeingPolicy : public FakePolicy {
 public:
  SeeingPolicy() : spec_(FakePolicy::spec()) {
    spec_.cameras = {"agentview"};
    spec_.image_width = 640;
    spec_.image_height = 480;
  }
  const PolicySpec& spec() const override { return spec_; }

 private:
  PolicySpec spec_;
};

// Most memory that this process has held [MiB].
double PeakMib() {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    int64_t kib = 0;
    if (line.rfind("VmHWM:", 0) == 0 && absl::SimpleAtoi(line.substr(6, line.size() - 6 - 2), &kib))
      return static_cast<double>(kib) / 1024;
  }
  return 0;
}

#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr double kMostMib = 4096;  // a sanitizer keeps what was freed
#else
constexpr double kMostMib = 64;
#endif

class SessionRecovery : public ::testing::Test {
 protected:
  SessionRecovery()
      : root_(fs::path(::testing::TempDir()) / absl::StrCat("recovery-", getpid())),
        folder_((root_ / "session").string()) {
    fs::remove_all(root_);
    fs::create_directories(root_);
    rig_.policy = std::make_shared<SeeingPolicy>();
  }
  ~SessionRecovery() override { fs::remove_all(root_); }

  SessionSpec spec_ = Spec("ours", {kRate, "buffer_chunks=8", "update_interval=1000000"});
  Rig rig_;
  const fs::path root_;
  const std::string folder_;
};

// ROBOSTRESS_RECOVERY_MIB=2048 recovers as much; 192 without it.
TEST_F(SessionRecovery, ReadsAJournalOfAnySizeInTheMemoryOfItsState) {
  const char* const asked = std::getenv("ROBOSTRESS_RECOVERY_MIB");
  const int mib = asked == nullptr ? 192 : std::atoi(asked);
  v1::StateHeader header;
  header.set_session_id("session");
  *header.mutable_spec() = ToProto(RequestOf(spec_));
  header.set_model_hash("fake-hash");
  auto journal = SessionJournal::Create(folder_, header);
  ASSERT_TRUE(journal.ok()) << journal.status();
  SessionResources resources{rig_.policy, &rig_.adaptation, &rig_.inference, absl::Seconds(20)};
  resources.snapshot_bytes = resources.snapshot_records = UINT64_MAX;  // one journal grows on
  const auto made = Session::Create(spec_, resources, 1);
  ASSERT_TRUE(made.ok()) << made.status();
  Session* const session = made->get();
  session->SetJournal(*std::move(journal));
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  ToyArm arm(0.6);
  Observation observation = FakePolicy::MakeObservation(0);
  observation.views.push_back({"agentview", {640, 480, std::vector<uint8_t>(3 * 640 * 480, 7)}});
  const auto shared = Shared(std::move(observation));
  const uint64_t chunks = static_cast<uint64_t>(mib) * 1024 * 1024 / (3 * 640 * 480);
  for (uint64_t i = 1; i <= chunks; ++i) {
    const auto prediction = session->Predict(shared, {{0, 0}, static_cast<int>(i - 1)}, i - 1);
    ASSERT_TRUE(prediction.ok()) << prediction.status();
    ExecutedChunk executed = arm.Execute(*prediction, 5);
    executed.sequence = i;
    executed.chunk = static_cast<int>(i - 1);
    ASSERT_TRUE(session->Feedback(executed).ok());
  }
  ASSERT_TRUE(WriteFileAtomically((root_ / "before").string(), ExportOf(*session)).ok());
  session->Cancel();
  ASSERT_GT(fs::file_size(folder_ + "/journal-000000"),
            uint64_t{0x80000} * static_cast<uint64_t>(mib));

  // In a process of its own, whose peak is not the writer's.
  setenv("ROBOSTRESS_RECOVERY_OF", root_.c_str(), 1);
  const auto [output, code] =
      RunProgram(fs::read_symlink("/proc/self/exe").string(),
                 "--gtest_also_run_disabled_tests --gtest_filter=SessionRecovery.DISABLED_Reader");
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, ::testing::HasSubstr(absl::StrCat("recovered ", chunks, " chunks")))
      << output;
}

// What the test above starts.
TEST_F(SessionRecovery, DISABLED_Reader) {
  const char* const written = std::getenv("ROBOSTRESS_RECOVERY_OF");
  if (written == nullptr) GTEST_SKIP() << "no journal was written for it";
  auto session = rig_.Open(spec_);
  const double start = PeakMib();
  const absl::Status status = session->Recover(absl::StrCat(written, "/session"));
  ASSERT_TRUE(status.ok()) << status;
  const double more = PeakMib() - start;
  EXPECT_LT(more, kMostMib);
  EXPECT_EQ(ExportOf(*session), ReadFile(absl::StrCat(written, "/before")).value());
  std::printf("recovered %d chunks with %.0f MiB of memory\n",
              static_cast<int>(session->Position().feedback_sequence), more);
}

TEST_F(SessionRecovery, EveryEventComesBackAsItWent) {
  const auto back = [](const std::string& bytes) {
    v1::StateRecord record;
    EXPECT_TRUE(record.ParseFromString(bytes));
    auto event = DecodeEvent(record);
    EXPECT_TRUE(event.ok()) << event.status();
    return *std::move(event);
  };
  const auto started = std::get<EpisodeStarted>(back(EncodeEvent(EpisodeStarted{{3, 4}, 5})));
  EXPECT_EQ(started.key, (EpisodeKey{3, 4}));
  EXPECT_EQ(started.last_sequence, 5u);
  EXPECT_EQ(std::get<AdapterImported>(back(EncodeEvent(AdapterImported{"bytes"}))).safetensors,
            "bytes");
  EXPECT_EQ(std::get<AdapterRolledBack>(back(EncodeEvent(AdapterRolledBack{6}))).version, 6u);
  const auto pin = std::get<VersionPinned>(back(EncodeEvent(VersionPinned{7, true})));
  EXPECT_EQ(pin.version, 7u);
  EXPECT_TRUE(pin.pinned);
  Prediction prediction{.id = 9, .key = {{1, 2}, 3}};
  prediction.raw = torch::arange(80, torch::kFloat32).reshape({10, 8});
  prediction.state = torch::ones({1, 3});
  Observation observation = FakePolicy::MakeObservation(1);
  observation.views.push_back({"wrist", {2, 1, {1, 2, 3, 4, 5, 6}}});
  prediction.observation = Shared(observation);
  const auto read = std::get<Prediction>(back(EncodeEvent(prediction)));
  EXPECT_EQ(read.id, 9u);
  EXPECT_EQ(read.key, prediction.key);
  EXPECT_TRUE(BitEqual(read.raw, prediction.raw));
  EXPECT_TRUE(BitEqual(read.state, prediction.state));
  EXPECT_EQ(read.observation->instruction, observation.instruction);
  EXPECT_EQ(read.observation->proprioception, observation.proprioception);
  ASSERT_EQ(read.observation->views.size(), 1u);
  EXPECT_EQ(read.observation->views[0].camera, "wrist");
  EXPECT_EQ(read.observation->views[0].image.data, observation.views[0].image.data);
  EXPECT_TRUE(read.journaled);
  ExecutedChunk executed = ToyArm(1).Execute(ConstantPrediction(Eigen::VectorXf::Ones(7), 5), 2);
  executed.sequence = 11;
  executed.masked = {true, false};
  const auto chunk = std::get<ExecutedChunk>(back(EncodeEvent(executed)));
  EXPECT_EQ(chunk.sequence, 11u);
  EXPECT_EQ(chunk.masked, executed.masked);
  EXPECT_EQ(chunk.final_state.tool.p_base_tool, executed.final_state.tool.p_base_tool);
}

}  // namespace
}  // namespace robostress
