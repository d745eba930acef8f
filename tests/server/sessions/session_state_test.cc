// A state that breaks server/sessions/state_rules.h, from the wire and from the disk: it fails
// alone.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <limits>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/record_file.h"
#include "server/sessions/session_registry.h"
#include "tests/server/sessions/drive.h"
#include "tests/server/sessions/state_file.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

const std::vector<std::string> kOften{kRate, "buffer_chunks=8", "update_interval=8", "batch=4"};

StateFile Exported(Rig& rig, int chunks, const std::string& method = "ours") {
  Client client(rig.Open(Spec(method, kOften)));
  client.StartEpisode(0, 0);
  client.RunChunks(chunks);
  return StateFile::Parse(ExportOf(client.session()));
}

// What a session says to a file, which must not change it.
absl::Status Refusal(Session& session, const StateFile& file) {
  const std::string before = ExportOf(session);
  const absl::Status status = session.Import(file.Serialize()).status();
  EXPECT_TRUE(ExportOf(session) == before) << "changed by what it refused: " << status;
  return status;
}

TEST(SessionState, ABufferThatIsTooSmallForTheNextBatchIsRefusedByTheImport) {
  Rig rig;
  const StateFile file = Exported(rig, 31);
  const auto wide =
      rig.Open(Spec("ours", {kRate, "buffer_chunks=32", "update_interval=8", "batch=16"}));
  const absl::Status status = Refusal(*wide, file);
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()),
              HasSubstr("the buffer holds 8 chunks after 31 and would hold 9 when the update at 32 "
                        "falls due; this session's batch is 16"));
  // With room for what it holds it goes on.
  Client fits(rig.Open(Spec("ours", {kRate, "buffer_chunks=32", "update_interval=8", "batch=9"})));
  ASSERT_TRUE(fits.session().Import(file.Serialize()).ok());
  fits.set_sequence(31);
  fits.StartEpisode(0, 1);
  fits.RunChunk();
  EXPECT_EQ(fits.updates(), 4u);
}

// Every relation of schedule and buffer: what is accepted learns on, what is refused would not.
TEST(SessionState, AcceptsExactlyTheBuffersThatFillEveryBatch) {
  Rig rig;
  const StateFile full = Exported(rig, 12);
  int accepted = 0, refused = 0;
  for (const auto& [capacity, interval, batch] :
       std::vector<std::array<int, 3>>{{8, 8, 8}, {8, 3, 5}, {10, 4, 7}, {12, 1, 12}}) {
    for (int chunks = 0; chunks <= 30; chunks += 3) {
      for (int held = 0; held <= 8; held += 2) {
        StateFile file = full;
        file.metadata["buffered"] = absl::StrCat(held);
        file.metadata["chunks_since_clear"] = absl::StrCat(chunks);
        file.metadata["feedback_sequence"] = "100";
        // The first trigger after `chunks`, counted one by one.
        int next = chunks + 1, size = std::min(capacity, held + 1);
        while (next < capacity || (next - capacity) % interval != 0) {
          ++next;
          size = std::min(capacity, size + 1);
        }
        const bool valid = held <= chunks && size >= batch;
        Client client(rig.Open(Spec(
            "ours", {kRate, absl::StrCat("buffer_chunks=", capacity),
                     absl::StrCat("update_interval=", interval), absl::StrCat("batch=", batch)})));
        const auto imported = client.session().Import(file.Serialize());
        ASSERT_EQ(imported.ok(), valid) << capacity << " " << interval << " " << batch << " "
                                        << chunks << " " << held << imported.status();
        (valid ? accepted : refused)++;
        if (!valid) continue;
        client.set_sequence(100);
        client.StartEpisode(0, 0);
        client.RunChunks(next - chunks);
      }
    }
  }
  EXPECT_GT(accepted, 50);
  EXPECT_GT(refused, 50);
}

TEST(SessionState, ImportNamesEveryFieldThatCannotBe) {
  Rig rig;
  const StateFile good = Exported(rig, 12);
  const auto session = rig.Open(Spec("ours", kOften));
  ASSERT_TRUE(session->Import(good.Serialize()).ok());
  struct Case {
    std::string field, value, message;
  };
  const std::string most = absl::StrCat(uint64_t{1} << 53);
  for (const Case& c : std::vector<Case>{
           {"feedback_sequence", "18446744073709551615", "at most " + most},
           {"triggers", "18446744073709551615", "triggers 18446744073709551615; neither can be"},
           {"triggers", "13", "triggers 13; neither can be above feedback_sequence, 12"},
           {"version", "18446744073709551615", "version is"},
           {"adam_steps", "-1", "adam_steps is -1"},
           {"adam_steps", "9223372036854775807", "adam_steps is"},
           {"chunks_since_clear", "-9223372036854775808",
            "chunks_since_clear is -9223372036854775808"},
           {"chunks_since_clear", "9223372036854775807", "chunks_since_clear is"},
           {"chunks_since_clear", "13", "chunks_since_clear is 13"},
           {"chunks_since_clear", "7", "cannot hold more than came"},
           {"task", "-2", "task is -2"},
           {"task", "4294967296", "task is 4294967296"},
           {"nominal_task", "9223372036854775807", "nominal_task is"},
           {"nominal_episode", "-9223372036854775808", "nominal_episode is"},
           {"buffered", "9", "buffer.008"},
           {"buffered", "-1", "-1 buffered chunks"},
           {"buffered", "2147483647", "2147483647 buffered chunks"},
           {"layers", "0", "layers; this policy has 1"},
           {"layers", "2147483647", "layers; this policy has 1"}}) {
    StateFile file = good;
    file.metadata[c.field] = c.value;
    const absl::Status status = Refusal(*session, file);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << c.field << " " << c.value;
    EXPECT_THAT(std::string(status.message()), HasSubstr(c.message)) << c.field << " " << c.value;
  }
}

TEST(SessionState, ImportNamesEveryTensorOfAnotherShapeTypeOrValue) {
  Rig rig;
  const StateFile good = Exported(rig, 12);
  const auto session = rig.Open(Spec("ours", kOften));
  ASSERT_TRUE(session->Import(good.Serialize()).ok());
  const auto refused = [&](const std::string& name,
                           const std::function<void(StateFile::Entry&)>& change) {
    StateFile file = good;
    change(file.tensors.at(name));
    const absl::Status status = Refusal(*session, file);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << name;
    return std::string(status.message());
  };
  for (const auto& [name, entry] : good.tensors) {
    EXPECT_NE(refused(name, [](StateFile::Entry& e) { e.shape.push_back(1); }), "") << name;
    EXPECT_NE(refused(name, [](StateFile::Entry& e) { e.shape[0] = 0, e.Resize(); }), "") << name;
    if (entry.dtype != DType::kF64) {  // those are read as numbers of any type
      EXPECT_NE(refused(name, [](StateFile::Entry& e) { e.dtype = DType::kI64, e.Resize(); }), "");
    }
    if (entry.dtype != DType::kF32) continue;
    for (const float value : {std::nanf(""), std::numeric_limits<float>::infinity()})
      EXPECT_THAT(refused(name, [value](StateFile::Entry& e) { e.Set(0, value); }),
                  HasSubstr("not finite"))
          << name;
  }
  // Extents whose product is zero and whose strides overflow.
  EXPECT_THAT(refused("buffer.000.keys.0",
                      [](StateFile::Entry& e) {
                        e.shape = {int64_t{1} << 48, 0, int64_t{1} << 48, int64_t{1} << 48};
                        e.bytes.clear();
                      }),
              HasSubstr("keys.0"));
  EXPECT_THAT(refused("buffer.000.prefix_mask", [](StateFile::Entry& e) { e.bytes[0] = 2; }),
              HasSubstr("neither 0 nor 1"));
  EXPECT_THAT(refused("buffer.000.prefix_mask",
                      [](StateFile::Entry& e) { e.bytes.assign(e.bytes.size(), '\0'); }),
              HasSubstr("masks every slot"));
  EXPECT_THAT(refused("adam_v.in.A", [](StateFile::Entry& e) { e.Set(1, -1.0f); }),
              HasSubstr("adam_v holds a negative value"));
  for (const double value : {1e7, 1e308, std::nan(""), -std::numeric_limits<double>::infinity()})
    EXPECT_THAT(refused("nominal", [value](StateFile::Entry& e) { e.Set(3, value); }),
                HasSubstr("nominal holds"));
  EXPECT_THAT(refused("last_loss", [](StateFile::Entry& e) { e.Set(0, std::nan("")); }),
              HasSubstr("last_loss"));
}

TEST(SessionState, APrefixLongerThanThePolicysIsRefused) {
  Rig rig;
  StateFile file = Exported(rig, 8);
  for (auto& [name, entry] : file.tensors) {
    if (!absl::StartsWith(name, "buffer.000.")) continue;
    if (absl::StrContains(name, "prefix_mask")) entry.shape[1] = 9;
    if (absl::StrContains(name, "keys") || absl::StrContains(name, "values")) entry.shape[2] = 9;
    entry.Resize();
  }
  for (char& byte : file.tensors.at("buffer.000.prefix_mask").bytes) byte = 1;
  EXPECT_THAT(std::string(Refusal(*rig.Open(Spec("ours", kOften)), file).message()),
              HasSubstr("[1, 1..8]"));
}

TEST(SessionState, AnEncoderThatThrowsFailsItsPredictionAlone) {
  class Throwing : public FakePolicy {
   public:
    absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
      if (observation.instruction == "throw") throw std::runtime_error("no such layer");
      return FakePolicy::Encode(observation);
    }
  };
  Rig rig;
  rig.policy = std::make_shared<Throwing>();
  const auto session = rig.Open(Spec("ours", kOften));
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  const auto thrown =
      session->Predict(Shared(FakePolicy::MakeObservation(0, "throw")), {{0, 0}, 0}, 0);
  EXPECT_EQ(thrown.status().code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(thrown.status().message()), HasSubstr("no such layer"));
  EXPECT_TRUE(session->Predict(Shared(FakePolicy::MakeObservation(0)), {{0, 0}, 0}, 0).ok());
}

// A prefix that was dropped is encoded again by the update: what is thrown there fails its session.
TEST(SessionState, AnUpdateThatThrowsFailsItsSessionAndNoOther) {
  class ThrowingLater : public FakePolicy {
   public:
    absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
      if (observation.instruction == "throw" && armed) throw std::runtime_error("no such layer");
      return FakePolicy::Encode(observation);
    }
    mutable std::atomic<bool> armed{false};
  };
  const auto policy = std::make_shared<ThrowingLater>();
  Rig rig;
  rig.policy = policy;
  SessionResources tight{rig.policy, &rig.adaptation, &rig.inference, absl::Seconds(20)};
  tight.prefixes = std::make_shared<PrefixStore>(0);
  const SessionSpec spec = Spec("ours", {kRate, "buffer_chunks=1", "update_interval=1", "batch=1"});
  const auto session = *Session::Create(spec, tight, 77);
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  const auto prediction =
      session->Predict(Shared(FakePolicy::MakeObservation(0, "throw")), {{0, 0}, 0}, 0);
  ASSERT_TRUE(prediction.ok());
  policy->armed = true;
  ToyArm arm(0.6);
  ExecutedChunk executed = arm.Execute(*prediction, 5);
  executed.sequence = 1;
  ASSERT_TRUE(session->Feedback(executed).ok());
  EXPECT_EQ(session->Counters().status().code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(session->failure().message()), HasSubstr("no such layer"));
  Client other(rig.Open(Spec("ours", kOften)));
  other.StartEpisode(0, 0);
  other.RunChunks(9);
  EXPECT_EQ(other.updates(), 1u);
}

// --------------------------------------------------------------------------------------- from disk

class StateOnDisk : public ::testing::Test {
 protected:
  StateOnDisk() : folder_(absl::StrCat(::testing::TempDir(), "/state-on-disk-", getpid())) {
    fs::remove_all(folder_);
    Start();
  }
  ~StateOnDisk() override {
    registry_.reset();
    fs::remove_all(folder_);
  }

  void Start() {
    registry_.reset();
    SessionRegistryOptions options;
    options.state_dir = folder_;
    auto registry = SessionRegistry::Create(
        options,
        [this](const std::string&) -> absl::StatusOr<SessionResources> {
          return SessionResources{rig_.policy, &rig_.adaptation, &rig_.inference,
                                  absl::Seconds(20)};
        },
        &clock_);
    ASSERT_TRUE(registry.ok()) << registry.status();
    registry_ = *std::move(registry);
  }
  OpenedSession Open(const SessionSpec& spec) {
    auto opened = registry_->Open({spec, {}, {}});
    EXPECT_TRUE(opened.ok()) << opened.status();
    return *std::move(opened);
  }
  // The records of one file, changed.
  void Rewrite(const std::string& id, const std::string& name,
               const std::function<void(std::vector<v1::StateRecord>&)>& change) {
    const std::string path = absl::StrCat(folder_, "/", id, "/", name);
    std::vector<v1::StateRecord> records;
    const auto take = [&records](std::string_view payload) -> absl::Status {
      records.emplace_back().ParseFromArray(payload.data(), static_cast<int>(payload.size()));
      return absl::OkStatus();
    };
    ASSERT_TRUE(ReadRecords(path, false, take).ok());
    change(records);
    fs::remove(path);
    const auto writer = RecordWriter::Create(path);
    for (const v1::StateRecord& record : records)
      ASSERT_TRUE((*writer)->Append(record.SerializeAsString()).ok());
  }
  absl::Status ErrorOf(const std::string& id) {
    for (const SessionRow& row : registry_->List())
      if (row.id == id) return row.error;
    return absl::NotFoundError(id);
  }

  const std::string folder_;
  Rig rig_;
  ManualClock clock_{1'000'000'000};
  std::unique_ptr<SessionRegistry> registry_;
};

// As a server of before the rules left it: the import is in the journal.
TEST_F(StateOnDisk, AJournalWhoseImportBreaksTheRulesIsSetAsideAndTheServerGoesOn) {
  const StateFile file = Exported(rig_, 31);
  SessionSpec spec = Spec("ours", {kRate, "buffer_chunks=32", "update_interval=8", "batch=8"});
  const OpenedSession bad = Open(spec), good = Open(Spec("ours", kOften));
  Client client(good.session);
  client.StartEpisode(0, 0);
  client.RunChunks(9);
  const std::string bits = ExportOf(*good.session);
  Start();
  Rewrite(bad.id, "journal-000000", [&](std::vector<v1::StateRecord>& records) {
    StateFile broken = file;
    broken.metadata["buffered"] = "3";  // 4 when the update at 32 falls due
    records.emplace_back().mutable_imported()->set_safetensors(broken.Serialize());
  });
  for (int start = 0; start < 3; ++start) {
    Start();
    const absl::Status status = registry_->Resume(bad.id, bad.token).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss);
    EXPECT_THAT(std::string(status.message()), HasSubstr("this session's batch is 8"));
    EXPECT_THAT(std::string(ErrorOf(bad.id).message()), HasSubstr("this session's batch is 8"));
    const auto resumed = registry_->Resume(good.id, good.token);
    ASSERT_TRUE(resumed.ok()) << resumed.status();
    EXPECT_EQ(ExportOf(*resumed->session), bits);
  }
  EXPECT_TRUE(fs::exists(folder_ + "/" + bad.id + "/journal-000000")) << "its files stay";
  // An operator who has repaired it takes the mark away.
  Rewrite(bad.id, "journal-000000",
          [](std::vector<v1::StateRecord>& records) { records.pop_back(); });
  fs::remove(folder_ + "/" + bad.id + "/FAILED");
  Start();
  EXPECT_TRUE(registry_->Resume(bad.id, bad.token).ok());
}

TEST_F(StateOnDisk, ASnapshotThatBreaksTheRulesIsSetAsideWithWhatIsWrong) {
  struct Case {
    std::string method;  // or an option of base
    std::function<void(v1::StateRecord&)> change;
    std::string message;
  };
  const auto adaptation = [](const std::function<void(v1::StateAdaptation&)>& change) {
    return [change](v1::StateRecord& record) {
      if (record.has_adaptation()) change(*record.mutable_adaptation());
    };
  };
  const auto file = [&](const std::function<void(StateFile&)>& change) {
    return adaptation([change](v1::StateAdaptation& a) {
      StateFile state = StateFile::Parse(a.adapter());
      change(state);
      a.set_adapter(state.Serialize());
    });
  };
  const auto first_prediction = [](const std::function<void(v1::StatePrediction&)>& change) {
    return [change](v1::StateRecord& record) {
      if (record.has_prediction()) change(*record.mutable_prediction());
    };
  };
  const uint64_t huge = std::numeric_limits<uint64_t>::max();
  const std::vector<Case> cases{
      {"ours", adaptation([&](auto& a) { a.set_feedback_sequence(huge); }), "feedback_sequence is"},
      {"ours", adaptation([&](auto& a) { a.set_feedback_sequence(11); }), "the session at 11"},
      {"ours", adaptation([](auto& a) { a.set_next_prediction(0); }), "next_prediction is 0"},
      {"ours", adaptation([&](auto& a) { a.set_next_prediction(huge); }), "next_prediction is"},
      {"ours", adaptation([](auto& a) { a.set_next_prediction(5); }), "and the next is 5"},
      {"ours", adaptation([](auto& a) { a.set_task(-7); }), "task is -7"},
      {"ours", adaptation([](auto& a) { a.set_episode(int64_t{1} << 40); }), "episode is"},
      {"ours", adaptation([](auto& a) { a.add_boundaries(3); }), "waits for feedback 3"},
      {"ours", adaptation([](auto& a) {
         for (int i = 0; i < 1025; ++i) a.add_boundaries(99);
       }),
       "1025 boundaries"},
      {"ours", adaptation([](auto& a) { a.clear_adapter(); }), "an adapter is missing"},
      {"ours", file([](StateFile& f) { f.metadata["chunks_since_clear"] = "-5"; }), "is -5"},
      {"ours", file([](StateFile& f) { f.metadata["triggers"] = "99"; }), "triggers 99"},
      {"ours", first_prediction([](auto& p) {
         p.mutable_state()->set_shape(1, 2), p.mutable_state()->mutable_data()->resize(8);
       }),
       "state is not [1, 3]"},
      {"ours", first_prediction([](auto& p) {
         p.mutable_raw()->set_shape(0, 20), p.mutable_raw()->set_shape(1, 4);
       }),
       "raw is not [10, 8]"},
      {"ours", first_prediction([](auto& p) { p.clear_observation(); }), "lacks its observation"},
      {"ours", first_prediction([](auto& p) { p.mutable_observation()->add_proprioception(1); }),
       "proprioception has 4"},
      {"ours", first_prediction([](auto& p) { p.set_id(0); }), "number 0"},
      {"ours", first_prediction([](auto& p) { p.set_episode(1u << 25); }), "above"},
      {"ours_intent", first_prediction([](auto& p) {
         p.mutable_base()->set_rows(7), p.mutable_base()->set_cols(10);
       }),
       "base is 7 x 10"},
      {"ours_intent", first_prediction([](auto& p) { p.clear_base(); }), "base is 0 x 0"},
      {"ours",
       [](v1::StateRecord& r) {
         if (r.has_version()) r.mutable_version()->mutable_parameters(0)->set_shape(0, 1);
       },
       "version"},
      {"ours",
       [](v1::StateRecord& r) {
         if (r.has_version()) r.mutable_version()->set_loss(std::nan(""));
       },
       "loss nan"},
      {"ours",
       [](v1::StateRecord& r) {
         if (r.has_version()) r.mutable_version()->set_feedback_sequence(99);
       },
       "after feedback 99"},
      {"ours",
       [](v1::StateRecord& r) {
         if (r.has_buffered())
           r.mutable_buffered()->mutable_target()->set_shape(0, 8),
               r.mutable_buffered()->mutable_target()->set_shape(1, 10);
       },
       "target is not [10, 8]"},
      {"direct", adaptation([](auto& a) { a.add_direct_correction(1); }),
       "direct_correction has 8"},
      {"direct", adaptation([](auto& a) { a.set_direct_correction(0, std::nan("")); }),
       "cannot have"},
      {"ours_integral", adaptation([](auto& a) { a.mutable_integral_action()->RemoveLast(); }),
       "cannot have"},
      {"ours_integral", adaptation([](auto& a) { a.set_integral_action(0, 1e30); }), "cannot have"},
      {"ours_following", adaptation([](auto& a) { a.set_model_following(0, 1e308); }),
       "cannot have"},
      {"ours_following", adaptation([](auto& a) { a.add_model_following(0); }), "cannot have"},
      {"goal_memory=0.5", adaptation([](auto& a) { a.set_leaky_goal(0, 1e30); }), "cannot have"},
      {"integral_rate=0.01,envelope_share=0.2",
       adaptation([](auto& a) { a.set_envelope(0, 1e30); }), "cannot have"},
      {"calibrator_memory=100", adaptation([](auto& a) { a.set_residual_calibrator(0, -1); }),
       "cannot have"}};
  for (size_t i = 0; i < cases.size(); ++i) {
    const Case& c = cases[i];
    std::vector<std::string> overrides;
    if (c.method == "ours" || c.method == "ours_intent") overrides = kOften;
    const bool is_option = absl::StrContains(c.method, '=');
    if (is_option) overrides = absl::StrSplit(c.method, ',');
    const OpenedSession opened = Open(Spec(is_option ? "base" : c.method, overrides));
    Client client(opened.session);
    client.StartEpisode(0, 0);
    client.RunChunks(12);
    client.Predict();
    ASSERT_TRUE(opened.session->Flush().ok());
    Start();
    Rewrite(opened.id, "snapshot-000001", [&](std::vector<v1::StateRecord>& records) {
      for (v1::StateRecord& record : records) c.change(record);
    });
    // The one before it, which would be used instead, is gone.
    Start();
    fs::remove(absl::StrCat(folder_, "/", opened.id, "/journal-000000"));
    const absl::Status status = registry_->Resume(opened.id, opened.token).status();
    EXPECT_EQ(status.code(), absl::StatusCode::kDataLoss) << i << " " << status;
    if (!absl::StrContains(status.message(), "is missing; restore it")) {
      EXPECT_THAT(std::string(status.message()), HasSubstr(c.message)) << i;
    }
    Start();
    EXPECT_THAT(std::string(ErrorOf(opened.id).message()), HasSubstr("set aside")) << i;
    ASSERT_TRUE(registry_->Close(opened.id).ok());
  }
}

TEST_F(StateOnDisk, ASessionAtWhichTheServerDiedTwiceIsSetAsideAndOneDeathIsForgiven) {
  const OpenedSession once = Open(Spec("ours", kOften)), twice = Open(Spec("ours", kOften));
  // What a reading that never ended leaves.
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/" + once.id + "/READING", "1\n").ok());
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/" + twice.id + "/READING", "2\n").ok());
  Start();
  EXPECT_TRUE(registry_->Resume(once.id, once.token).ok());
  EXPECT_FALSE(fs::exists(folder_ + "/" + once.id + "/READING")) << "it was read";
  for (int start = 0; start < 2; ++start) {
    EXPECT_THAT(std::string(ErrorOf(twice.id).message()), HasSubstr("ended 2 times in a row"));
    EXPECT_EQ(registry_->Resume(twice.id, twice.token).status().code(),
              absl::StatusCode::kDataLoss);
    Start();
  }
  EXPECT_TRUE(registry_->Close(twice.id).ok());
}

TEST_F(StateOnDisk, AReadingThatKillsTheProcessIsCountedBeforeItBegins) {
  const OpenedSession opened = Open(Spec("ours", kOften));
  Client client(opened.session);
  client.StartEpisode(0, 0);
  client.RunChunks(9);
  opened.session->Cancel();
  registry_.reset();
  for (int death = 0; death < 2; ++death) {
    const std::string reading = folder_ + "/" + opened.id + "/READING";
    const pid_t child = fork();
    if (child == 0) {
      // Only what a server does: no test's thread is alive here.
      const auto folders = SessionFolders::Open(folder_);
      if (!folders.ok()) _exit(1);
      (*folders)->BeginReading(opened.id);
      _exit(2);
    }
    int status = 0;
    ASSERT_EQ(waitpid(child, &status, 0), child);
    ASSERT_EQ(WEXITSTATUS(status), 2);
    EXPECT_EQ(*ReadFile(reading), absl::StrCat(death + 1, "\n"));
  }
  Start();
  EXPECT_FALSE(registry_->Resume(opened.id, opened.token).ok());
}

}  // namespace
}  // namespace robostress
