// Valid states with one to three fields changed: what import, recovery and replay make of them.
//
//   ROBOSTRESS_STATE_CASES=1000000 build/release/test_bin/state_fuzz_test     # 3,000 without it
//
// ROBOSTRESS_STATE_FIRST starts at another case; a case is a function of its number alone. Every
// case is a refusal that names what is wrong and changes nothing, or a session that then predicts,
// learns, rolls back, is exported and imported again. A session beside it keeps its bits.
#include <google/protobuf/message.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <limits>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "adapter/command_bounds.h"
#include "adapter/update_schedule.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/record_file.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/session_registry.h"
#include "tests/server/sessions/drive.h"
#include "tests/server/sessions/state_file.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

// One step instead of ten: a prediction's time is not what is tested.
class QuickPolicy : public FakePolicy {
 public:
  torch::Tensor Sample(const PolicyContext& context, const torch::Tensor& noise,
                       const LoraWeights* lora) const override {
    torch::NoGradGuard no_grad;
    return noise - Velocity(context, noise, torch::ones({noise.size(0)}), lora) / 4;
  }
};

// ------------------------------------------------------------------------------------- mutations

template <class T>
T Pick(RandomStream& random, const std::vector<T>& values) {
  return values[static_cast<size_t>(random.UniformInt(static_cast<int>(values.size())))];
}

double PickDouble(RandomStream& random) {
  constexpr double kInf = std::numeric_limits<double>::infinity();
  return Pick<double>(
      random, {0,    -0.0,   1,     -1,    0.5,    2,      11,     -101, 1e6,   1.1e6,       1e15,
               1e30, 3.5e38, -1e38, 1e308, -1e308, 5e-324, 1e-310, kInf, -kInf, std::nan("")});
}

uint64_t PickNumber(RandomStream& random) {
  if (random.UniformInt(2) == 0) return static_cast<uint64_t>(random.UniformInt(20));
  constexpr uint64_t kOne = 1;
  return Pick<uint64_t>(random, {kOne << 24,
                                 (kOne << 24) + 1,
                                 (kOne << 31) - 1,
                                 kOne << 31,
                                 kOne << 32,
                                 (kOne << 53) - 2,
                                 (kOne << 53) - 1,
                                 kOne << 53,
                                 (kOne << 53) + 1,
                                 kOne << 62,
                                 (kOne << 63) - 1,
                                 kOne << 63,
                                 ~kOne,
                                 ~uint64_t{0},
                                 1023,
                                 1024,
                                 1025,
                                 63,
                                 64,
                                 65});
}

std::string PickText(RandomStream& random) {
  if (random.UniformInt(3) > 0) return absl::StrCat(PickNumber(random));
  return Pick<std::string>(
      random, {"-1", "-2", "-9223372036854775808", "9223372036854775807", "18446744073709551615",
               "18446744073709551616", "", " 5", "1e3", "nan", "0x10", "per_matrix", "per_head",
               "base", "ours", "ours_nominal", "fake", "other"});
}

void MutateValues(RandomStream& random, StateFile::Entry& entry) {
  if (entry.bytes.empty()) return;
  const auto count = static_cast<int>(entry.bytes.size()) / DTypeSize(entry.dtype);
  const auto at = static_cast<size_t>(random.UniformInt(std::max(count, 1)));
  if (entry.dtype == DType::kF32) {
    entry.Set(at, static_cast<float>(PickDouble(random)));
  } else if (entry.dtype == DType::kF64) {
    entry.Set(at, PickDouble(random));
  } else {
    entry.bytes[at % entry.bytes.size()] =
        static_cast<char>(Pick<int>(random, {0, 1, 2, 127, 255}));
    if (random.UniformInt(4) == 0) entry.bytes.assign(entry.bytes.size(), '\0');
  }
}

void MutateShape(RandomStream& random, std::vector<int64_t>& shape) {
  const int choice = random.UniformInt(5);
  if (choice == 0) {
    shape.push_back(1);
  } else if (choice == 1 && !shape.empty()) {
    shape.pop_back();
  } else if (choice == 2 && shape.size() > 1) {
    std::swap(shape[0], shape[shape.size() - 1]);
  } else if (!shape.empty()) {
    const auto at = static_cast<size_t>(random.UniformInt(static_cast<int>(shape.size())));
    shape[at] = Pick<int64_t>(random, {0, 1, 2, 3, 4, 5, 8, 9, 16, shape[at] + 1, shape[at] * 2});
  }
}

// One field of an exported adapter.
void MutateFile(RandomStream& random, StateFile& file) {
  const auto any = [&random](auto& map) {
    return std::next(map.begin(), random.UniformInt(static_cast<int>(map.size())));
  };
  const int choice = random.UniformInt(10);
  if (choice < 3 && !file.metadata.empty()) {
    any(file.metadata)->second = PickText(random);
  } else if (choice < 5) {  // the schedule against the buffer, among numbers that are possible
    int buffered = std::atoi(file.metadata["buffered"].c_str());
    if (random.UniformInt(2) == 0 && buffered > 0) buffered = random.UniformInt(buffered + 1);
    for (auto at = file.tensors.begin(); at != file.tensors.end();) {
      const bool beyond =
          absl::StartsWith(at->first, "buffer.") && std::atoi(at->first.c_str() + 7) >= buffered;
      at = beyond ? file.tensors.erase(at) : std::next(at);
    }
    file.metadata["buffered"] = absl::StrCat(buffered);
    if (random.UniformInt(2) == 0)
      file.metadata["chunks_since_clear"] = absl::StrCat(random.UniformInt(70));
    if (random.UniformInt(2) == 0)
      file.metadata["feedback_sequence"] = absl::StrCat(PickNumber(random));
  } else if (choice == 5 && !file.metadata.empty()) {
    file.metadata.erase(any(file.metadata));
  } else if (file.tensors.empty()) {
    return;
  } else if (choice == 6) {
    MutateShape(random, any(file.tensors)->second.shape);
  } else if (choice == 7) {
    any(file.tensors)->second.dtype =
        Pick<DType>(random, {DType::kF32, DType::kF64, DType::kF16, DType::kBF16, DType::kBool,
                             DType::kI64, DType::kU8, DType::kI32});
  } else if (choice == 8 && random.UniformInt(4) == 0) {
    file.tensors.erase(any(file.tensors));
  } else {
    MutateValues(random, any(file.tensors)->second);
  }
  for (auto& [name, entry] : file.tensors) entry.Resize();
}

std::string MutatedFile(RandomStream& random, const std::string& bytes) {
  if (!SafetensorsFile::Parse("state", bytes).ok()) return bytes;  // changed before
  StateFile file = StateFile::Parse(bytes);
  for (int i = 1 + random.UniformInt(3); i > 0; --i) MutateFile(random, file);
  return file.Serialize();
}

// One field somewhere in a message.
void MutateMessage(RandomStream& random, Message& message) {
  const auto* descriptor = message.GetDescriptor();
  const auto* reflection = message.GetReflection();
  std::vector<const FieldDescriptor*> fields;
  reflection->ListFields(message, &fields);
  if (random.UniformInt(8) == 0 || fields.empty()) {  // one that may be absent
    if (descriptor->field_count() == 0) return;
    fields = {descriptor->field(random.UniformInt(descriptor->field_count()))};
  }
  const FieldDescriptor* field = Pick(random, fields);
  const bool repeated = field->is_repeated();
  if (!repeated && random.UniformInt(12) == 0) return reflection->ClearField(&message, field);
  const int size = repeated ? reflection->FieldSize(message, field) : 0;
  if (repeated && size > 0 && random.UniformInt(4) == 0)
    return reflection->RemoveLast(&message, field);
  const bool add = repeated && (size == 0 || random.UniformInt(4) == 0);
  const int at = size > 0 ? random.UniformInt(size) : 0;
  switch (field->cpp_type()) {
    case FieldDescriptor::CPPTYPE_MESSAGE: {
      if (add) reflection->AddMessage(&message, field);
      return MutateMessage(
          random, repeated ? *reflection->MutableRepeatedMessage(&message, field, add ? size : at)
                           : *reflection->MutableMessage(&message, field));
    }
#define ROBOSTRESS_MUTATE(TYPE, NAME, VALUE)                                        \
  case FieldDescriptor::CPPTYPE_##TYPE:                                             \
    if (add) return reflection->Add##NAME(&message, field, VALUE);                  \
    if (repeated) return reflection->SetRepeated##NAME(&message, field, at, VALUE); \
    return reflection->Set##NAME(&message, field, VALUE)
      ROBOSTRESS_MUTATE(INT32, Int32, static_cast<int32_t>(PickNumber(random)));
      ROBOSTRESS_MUTATE(INT64, Int64, static_cast<int64_t>(PickNumber(random)));
      ROBOSTRESS_MUTATE(UINT32, UInt32, static_cast<uint32_t>(PickNumber(random)));
      ROBOSTRESS_MUTATE(UINT64, UInt64, PickNumber(random));
      ROBOSTRESS_MUTATE(DOUBLE, Double, PickDouble(random));
      ROBOSTRESS_MUTATE(FLOAT, Float, static_cast<float>(PickDouble(random)));
      ROBOSTRESS_MUTATE(BOOL, Bool, random.UniformInt(2) == 0);
      ROBOSTRESS_MUTATE(ENUM, EnumValue, random.UniformInt(5));
#undef ROBOSTRESS_MUTATE
    case FieldDescriptor::CPPTYPE_STRING: {
      std::string text = repeated && !add ? reflection->GetRepeatedString(message, field, at)
                         : repeated       ? ""
                                          : reflection->GetString(message, field);
      if ((field->name() == "adapter" || field->name() == "safetensors") && !text.empty()) {
        text = MutatedFile(random, text);
      } else if (text.empty() || random.UniformInt(4) == 0) {
        text = PickText(random);
      } else {
        text[static_cast<size_t>(random.UniformInt(static_cast<int>(text.size())))] =
            static_cast<char>(field->type() == FieldDescriptor::TYPE_STRING
                                  ? random.UniformInt(128)
                                  : random.UniformInt(256));
      }
      if (add) return reflection->AddString(&message, field, text);
      if (repeated) return reflection->SetRepeatedString(&message, field, at, text);
      return reflection->SetString(&message, field, text);
    }
  }
}

// Half of the tensors whose shape was changed get the bytes that it needs.
void FillTensors(RandomStream& random, Message& message) {
  std::vector<const FieldDescriptor*> fields;
  const auto* reflection = message.GetReflection();
  if (auto* tensor = dynamic_cast<v1::StateTensor*>(&message)) {
    static constexpr int kSizes[] = {4, 8, 2, 2, 1};
    uint64_t bytes = tensor->type() < 5 ? static_cast<uint64_t>(kSizes[tensor->type()]) : 0;
    for (const int64_t extent : tensor->shape())
      bytes =
          extent >= 0 && extent < 4096 && bytes < 65536 ? bytes * static_cast<uint64_t>(extent) : 0;
    if (bytes < 65536 && random.UniformInt(2) == 0) tensor->mutable_data()->resize(bytes);
    return;
  }
  reflection->ListFields(message, &fields);
  for (const FieldDescriptor* field : fields) {
    if (field->cpp_type() != FieldDescriptor::CPPTYPE_MESSAGE) continue;
    if (!field->is_repeated()) {
      FillTensors(random, *reflection->MutableMessage(&message, field));
      continue;
    }
    for (int i = 0; i < reflection->FieldSize(message, field); ++i)
      FillTensors(random, *reflection->MutableRepeatedMessage(&message, field, i));
  }
}

// ----------------------------------------------------------------------------------------- driving

// The refusals of a state, or of what comes after a number that leaves no room for more.
bool Clean(const absl::Status& status) {
  if (status.message().empty()) return false;
  switch (status.code()) {
    case absl::StatusCode::kInvalidArgument:
    case absl::StatusCode::kDataLoss:
    case absl::StatusCode::kFailedPrecondition:
    case absl::StatusCode::kNotFound:  // of a header: method, policy
    case absl::StatusCode::kResourceExhausted:
      return true;
    case absl::StatusCode::kInternal:  // an adapter of huge values predicts no command
      return absl::StrContains(status.message(), "not finite, or above");
    default:
      return false;
  }
}

// Episodes of a session that was changed: predicts, executes, reports. CANCELLED marks a number at
// its end, after which nothing can go on.
absl::Status Drive(Session& session, RandomStream& random, int chunks) {
  ToyArm arm(0.6);
  const SessionPosition position = session.Position();
  uint64_t sequence = position.feedback_sequence;
  const int task = random.UniformInt(3) == 0 && position.episode ? position.episode->task : 1;
  RS_RETURN_IF_ERROR(session.StartEpisode({task, 3}, sequence));
  for (int chunk = 0; chunk < chunks; ++chunk) {
    if (sequence + 1 >= StateRules::kMaxCount ||
        session.Position().last_prediction_id + 2 >= StateRules::kMaxCount)
      return absl::CancelledError("at its end");
    Observation observation = FakePolicy::MakeObservation(chunk);
    RS_ASSIGN_OR_RETURN(const PredictedChunk prediction,
                        session.Predict(Shared(observation), {{task, 3}, chunk}, sequence));
    if (!prediction.actions.allFinite() ||
        prediction.actions.cwiseAbs().maxCoeff() > kWidestCommand)
      return absl::UnknownError("actions are out of range");
    ExecutedChunk executed = arm.Execute(prediction, 1 + random.UniformInt(5));
    executed.sequence = ++sequence;
    executed.task = task;
    executed.episode = 3;
    executed.chunk = chunk;
    RS_RETURN_IF_ERROR(session.Feedback(executed).status());
  }
  return session.Counters().status();
}

struct Variant {
  const char* method;
  std::vector<std::string> overrides;
};
const std::vector<Variant>& Variants() {
  static const std::vector<Variant> variants = {
      {"ours", {"buffer_chunks=2", "update_interval=1", "batch=1"}},
      {"ours", {"buffer_chunks=4", "update_interval=2", "batch=4"}},
      {"ours", {"buffer_chunks=4", "update_interval=2", "batch=2", "rank=2"}},
      {"ours", {"buffer_chunks=3", "update_interval=5", "batch=3"}},
      {"ours_nominal", {"buffer_chunks=2", "update_interval=1", "batch=2"}},
      {"ours_intent", {"buffer_chunks=4", "update_interval=1", "batch=3"}}};
  return variants;
}

class StateFuzz : public ::testing::Test {
 protected:
  StateFuzz()
      : folder_(fs::path(fs::exists("/dev/shm") ? "/dev/shm" : ::testing::TempDir().c_str()) /
                absl::StrCat("state-fuzz-", getpid())) {
    rig_.policy = std::make_shared<QuickPolicy>();
    fs::remove_all(folder_);
    fs::create_directories(folder_);
    StartRegistry();
    for (size_t v = 0; v < Variants().size(); ++v) MakeSeeds(v);
    neighbour_.emplace(rig_.Open(NeighbourSpec()));
    neighbour_->StartEpisode(0, 0);
    alone_.emplace(rig_.Open(NeighbourSpec()));
    alone_->StartEpisode(0, 0);
  }
  ~StateFuzz() override {
    registry_.reset();
    fs::remove_all(folder_);
  }

  static SessionSpec SpecOf(size_t variant) {
    std::vector<std::string> overrides = Variants()[variant].overrides;
    overrides.push_back(kRate);
    return Spec(Variants()[variant].method, overrides);
  }
  static SessionSpec NeighbourSpec() {
    return Spec("ours", {kRate, "buffer_chunks=4", "update_interval=1", "batch=2"});
  }

  // What a server wrote: a folder with a snapshot, a journal after it, an import and a pin.
  struct Seed {
    std::string file;                                                         // exported
    std::vector<std::pair<std::string, std::vector<v1::StateRecord>>> files;  // of its folder
  };

  void StartRegistry() {
    registry_.reset();
    SessionRegistryOptions options;
    options.state_dir = (folder_ / "sessions").string();
    options.caps = {256, 4096, 1, 4096};
    auto registry = SessionRegistry::Create(
        options,
        [this](const std::string& policy) -> absl::StatusOr<SessionResources> {
          if (policy != "fake") return absl::NotFoundError("policy " + policy);
          return SessionResources{rig_.policy, &rig_.adaptation, &rig_.inference,
                                  absl::Seconds(20)};
        },
        &clock_);
    ASSERT_TRUE(registry.ok()) << registry.status();
    registry_ = *std::move(registry);
  }

  void MakeSeeds(size_t variant) {
    RandomStream random(StreamKey("seeds").With(static_cast<int64_t>(variant)));
    for (const int chunks : {0, 3, 9}) {
      const auto opened = registry_->Open({SpecOf(variant), {}, {}});
      ASSERT_TRUE(opened.ok()) << opened.status();
      Session& session = *opened->session;
      ASSERT_TRUE(Drive(session, random, chunks).ok());
      if (chunks == 9) {
        ASSERT_TRUE(session.Pin(1, true).ok());
        ASSERT_TRUE(session.Import(ExportOf(session)).ok());
      }
      ASSERT_TRUE(session.Flush().ok());
      ASSERT_TRUE(Drive(session, random, chunks / 2).ok());
      ASSERT_TRUE(session
                      .Predict(Shared(FakePolicy::MakeObservation(1)),
                               {{session.Position().episode->task, 3}, 99},
                               session.Position().feedback_sequence)
                      .ok());
      Seed seed;
      seed.file = ExportOf(session);
      const fs::path folder = folder_ / "sessions" / opened->id;
      for (const auto& entry : fs::directory_iterator(folder)) {
        auto& [name, records] = seed.files.emplace_back();
        name = entry.path().filename().string();
        const auto take = [&records = records](std::string_view payload) -> absl::Status {
          if (records.emplace_back().ParseFromArray(payload.data(),
                                                    static_cast<int>(payload.size())))
            return absl::OkStatus();
          return absl::DataLossError("not a record");
        };
        ASSERT_TRUE(ReadRecords(entry.path().string(), false, take).ok());
      }
      seeds_.push_back(std::move(seed));
      ASSERT_TRUE(registry_->Close(opened->id).ok());
    }
  }

  // A session that keeps what a state did to it until it fails.
  Session& Target(size_t variant) {
    std::shared_ptr<Session>& target = targets_[variant];
    if (target == nullptr) target = rig_.Open(SpecOf(variant));
    return *target;
  }

  void CheckWorks(Session& session, RandomStream& random, const std::string& what) {
    const absl::Status driven = Drive(session, random, 2 + random.UniformInt(4));
    if (absl::IsCancelled(driven)) return;
    ASSERT_TRUE(driven.ok() || absl::IsInternal(driven)) << what << ": " << driven;
    if (!driven.ok()) {
      ASSERT_TRUE(Clean(driven)) << what << ": " << driven;
    }
    if (random.UniformInt(4) == 0) {
      const absl::Status back = session.Rollback(static_cast<uint64_t>(random.UniformInt(3)));
      ASSERT_TRUE(back.ok() || absl::IsNotFound(back) || absl::IsFailedPrecondition(back))
          << what << ": " << back;
      const absl::Status after = Drive(session, random, 2);
      ASSERT_TRUE(after.ok() || absl::IsCancelled(after) || Clean(after)) << what << ": " << after;
    }
    // What it is now is a state again.
    const std::string now = ExportOf(session);
    const absl::Status again = session.Import(now).status();
    ASSERT_TRUE(again.ok()) << what << ": " << again;
    ASSERT_TRUE(ExportOf(session) == now) << what;
  }

  void ImportCase(RandomStream& random, const std::string& what) {
    const auto variant =
        static_cast<size_t>(random.UniformInt(static_cast<int>(Variants().size())));
    const size_t seed =
        random.UniformInt(3) == 0
            ? static_cast<size_t>(random.UniformInt(static_cast<int>(seeds_.size())))
            : 3 * variant + static_cast<size_t>(random.UniformInt(3));
    Session& session = Target(variant);
    const std::string before = ExportOf(session);
    const auto imported = session.Import(MutatedFile(random, seeds_[seed].file));
    if (!imported.ok()) {
      ++refused_;
      ASSERT_TRUE(absl::IsInvalidArgument(imported.status())) << what << ": " << imported.status();
      ASSERT_GT(imported.status().message().size(), 20u);
      ASSERT_TRUE(ExportOf(session) == before) << what;
      return;
    }
    ++accepted_;
    CheckWorks(session, random, what);
    if (random.UniformInt(8) == 0) targets_.erase(variant);
  }

  void WriteFolder(RandomStream& random, const Seed& seed, const fs::path& folder) {
    fs::remove_all(folder);
    fs::create_directories(folder);
    const auto changed =
        static_cast<size_t>(random.UniformInt(static_cast<int>(seed.files.size())));
    for (size_t i = 0; i < seed.files.size(); ++i) {
      std::vector<v1::StateRecord> records = seed.files[i].second;
      for (int left = i == changed ? 1 + random.UniformInt(2) : 0; left > 0; --left) {
        const auto at = static_cast<size_t>(random.UniformInt(static_cast<int>(records.size())));
        const int choice = random.UniformInt(12);
        if (choice == 0) {
          records.insert(records.begin() + static_cast<int64_t>(at), records[at]);
        } else if (choice == 1 && records.size() > 1) {
          records.erase(records.begin() + static_cast<int64_t>(at));
        } else if (choice == 2) {
          std::swap(records[at], records.back());
        } else {
          MutateMessage(random, records[at]);
          FillTensors(random, records[at]);
        }
      }
      const auto writer = RecordWriter::Create((folder / seed.files[i].first).string());
      ASSERT_TRUE(writer.ok()) << writer.status();
      for (const v1::StateRecord& record : records)
        ASSERT_TRUE((*writer)->Append(record.SerializeAsString()).ok());
    }
  }

  // The folder as another start of the server finds it.
  void RestartCase(RandomStream& random, bool whole_registry, const std::string& what) {
    const auto variant =
        static_cast<size_t>(random.UniformInt(static_cast<int>(Variants().size())));
    const Seed& seed = seeds_[3 * variant + static_cast<size_t>(random.UniformInt(3))];
    const std::string id = "session-0123456789abcdef";
    const fs::path folder = folder_ / "sessions" / id;
    WriteFolder(random, seed, folder);
    if (!whole_registry) {
      auto session = rig_.Open(SpecOf(variant));
      CheckRecovered(session->Recover(folder.string()), *session, random, what);
      session->Cancel();
      return;
    }
    StartRegistry();
    const auto session = registry_->Load(id);
    if (session.ok()) {
      CheckRecovered(absl::OkStatus(), **session, random, what);
      (*session)->Cancel();
    } else {
      CheckRecovered(session.status(), neighbour_->session(), random, what);
      const auto rows = registry_->List();
      ASSERT_EQ(rows.size(), 1u) << what;
      // It says why, now and to every later start.
      StartRegistry();
      ASSERT_FALSE(registry_->Load(id).ok()) << what;
    }
    registry_->Close(id).IgnoreError();
  }

  void CheckRecovered(const absl::Status& status, Session& session, RandomStream& random,
                      const std::string& what) {
    if (!status.ok()) {
      ++refused_;
      ASSERT_TRUE(Clean(status)) << what << ": " << status;
      return;
    }
    ++accepted_;
    if (session.spec().method->adapts()) {
      CheckWorks(session, random, what);
    } else {
      ASSERT_TRUE(Drive(session, random, 2).ok()) << what;
    }
  }

  const fs::path folder_;
  Rig rig_;
  ManualClock clock_{1'000'000'000};
  std::unique_ptr<SessionRegistry> registry_;
  std::vector<Seed> seeds_;  // three of each variant
  std::map<size_t, std::shared_ptr<Session>> targets_;
  std::optional<Client> neighbour_, alone_;
  int64_t accepted_ = 0, refused_ = 0;
};

int64_t FromEnvironment(const char* name, int64_t otherwise) {
  const char* text = std::getenv(name);
  return text == nullptr ? otherwise : std::atoll(text);
}

TEST_F(StateFuzz, AChangedStateIsRefusedOrWorks) {
  const int64_t first = FromEnvironment("ROBOSTRESS_STATE_FIRST", 0);
  const int64_t cases = FromEnvironment("ROBOSTRESS_STATE_CASES", 3000);
  const auto begin = std::chrono::steady_clock::now();
  int64_t restarts = 0, neighbour_chunks = 0;
  for (int64_t i = first; i < first + cases; ++i) {
    const std::string what = absl::StrCat("case ", i);
    if (std::getenv("ROBOSTRESS_STATE_TRACE") != nullptr)
      std::fprintf(stderr, "%s\n", what.c_str());
    RandomStream random(StreamKey("state_fuzz").With(i));
    if (i % 8 == 7) {
      ++restarts;
      RestartCase(random, i % 64 == 63, what);
    } else {
      ImportCase(random, what);
    }
    if (::testing::Test::HasFatalFailure() || ::testing::Test::HasNonfatalFailure())
      FAIL() << "at case " << i;
    if (i % 500 == 499) {
      neighbour_->RunChunk();
      ++neighbour_chunks;
      if (neighbour_chunks % 20 == 0)
        neighbour_->StartEpisode(0, static_cast<int>(neighbour_chunks));
    }
    const int64_t done = i - first + 1;
    if (cases > 10000 && done % 10000 == 0) {
      const double seconds =
          std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
      std::fprintf(stderr, "%ld cases, %ld restarts, %ld accepted, %ld refused, %.0f cases/s\n",
                   done, restarts, accepted_, refused_, static_cast<double>(done) / seconds);
    }
  }
  for (int64_t i = 1; i <= neighbour_chunks; ++i) {
    alone_->RunChunk();
    if (i % 20 == 0) alone_->StartEpisode(0, static_cast<int>(i));
  }
  EXPECT_EQ(ExportOf(neighbour_->session()), ExportOf(alone_->session()));
  EXPECT_GT(accepted_, cases / 50);
  EXPECT_GT(refused_, cases / 50);
  std::fprintf(stderr, "%ld cases: %ld accepted, %ld refused, %ld restarts\n", cases, accepted_,
               refused_, restarts);
}

}  // namespace
}  // namespace robostress
