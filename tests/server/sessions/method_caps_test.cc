#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "server/sessions/session_checks.h"
#include "server/sessions/session_registry.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string Refusal(const std::vector<std::string>& overrides, const MethodCaps& caps = {}) {
  return std::string(CheckMethodCaps(*MakeMethod("ours", overrides), caps).message());
}

TEST(MethodCaps, NameOptionValueLimitAndFlag) {
  EXPECT_EQ(Refusal({"rank=17"}),
            "method ours: rank is 17, at most 16 is allowed here; the operator sets it with "
            "--max-rank, or for the token");
  EXPECT_THAT(Refusal({"batch=9"}), HasSubstr("batch is 9, at most 8 is allowed here; the operator "
                                              "sets it with --max-update-batch"));
  EXPECT_THAT(Refusal({"update_interval=3"}),
              HasSubstr("update_interval is 3, at least 4 is allowed here; the operator sets it "
                        "with --min-update-interval"));
  EXPECT_THAT(Refusal({"buffer_chunks=129"}),
              HasSubstr("buffer_chunks is 129, at most 128 is allowed here; the operator sets it "
                        "with --max-buffer-chunks"));
  EXPECT_EQ(Refusal({"rank=16", "batch=8", "update_interval=4", "buffer_chunks=128"}), "");
}

TEST(MethodCaps, LetEveryPresetPassAndAskNothingOfOneThatDoesNotAdapt) {
  for (const std::string& name : MethodNames())
    EXPECT_TRUE(CheckMethodCaps(*MakeMethod(name), {}).ok()) << name;
  EXPECT_FALSE(Refusal({}, {.max_rank = 1}).empty());
  EXPECT_TRUE(CheckMethodCaps(*MakeMethod("base"), {.max_rank = 1}).ok());
}

TEST(MethodCaps, TheTightestOfTwoTakesTheNarrowerOfEach) {
  const MethodCaps caps = Tightest({4, 8, 2, 64}, {16, 2, 8, 32});
  EXPECT_EQ(caps.max_rank, 4);
  EXPECT_EQ(caps.max_batch, 2);
  EXPECT_EQ(caps.min_update_interval, 8);
  EXPECT_EQ(caps.max_buffer_chunks, 32);
}

TEST(MethodCaps, AreAskedWhenASessionIsOpenedAndNotWhenItIsReadAgain) {
  const std::string folder = absl::StrCat(::testing::TempDir(), "/caps-", getpid());
  Rig rig;
  ManualClock clock(1);
  SessionRegistryOptions options;
  options.state_dir = folder;
  const auto resources = [&](const std::string&) -> absl::StatusOr<SessionResources> {
    return SessionResources{rig.policy, &rig.adaptation, &rig.inference, absl::Seconds(20)};
  };
  const SessionRequest request{Spec("ours", {"update_interval=2"}), {}, {}};
  OpenedSession opened;
  {
    const auto strict = *SessionRegistry::Create(options, resources, &clock);
    const absl::Status refused = strict->Open(request).status();
    EXPECT_EQ(refused.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(refused.message()), HasSubstr("--min-update-interval"));
    EXPECT_EQ(strict->open_sessions(), 0);
  }
  {
    SessionRegistryOptions wide = options;
    wide.caps.min_update_interval = 1;
    opened = *(*SessionRegistry::Create(wide, resources, &clock))->Open(request);
    opened.session = nullptr;
  }
  const auto strict = *SessionRegistry::Create(options, resources, &clock);
  EXPECT_TRUE(strict->Resume(opened.id, opened.token).ok());
  EXPECT_TRUE(strict->Close(opened.id).ok());
  std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace robostress
