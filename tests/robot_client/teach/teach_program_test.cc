// robot_client teach as a person uses it, against piper_emulator over UDP in a network namespace of
// its own, in real time: what is waited for are conditions, with generous ends.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/libero/demonstrations.h"
#include "common/safetensors.h"
#include "tests/common/lerobot/read_back.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;
namespace fs = std::filesystem;

constexpr char kHand[] =
    "t,J1,J2,J3,J4,J5,J6,opening\n"
    "1,0,1.2,-1.0,0,0.5,0,0.03\n2,0.4,1.0,-1.2,0,0.3,0,0.06\n3,0,1.2,-1.0,0,0.5,0,0.03\n"
    "4,0.4,1.0,-1.2,0,0.3,0,0.06\n5,0,1.2,-1.0,0,0.5,0,0.03\n"
    "6,0.4,1.0,-1.2,0,0.3,0,0.06\n7,0,1.2,-1.0,0,0.5,0,0.03\n"
    "8,0.4,1.0,-1.2,0,0.3,0,0.06\n9,0,1.2,-1.0,0,0.5,0,0.03\n"
    "10,0.4,1.0,-1.2,0,0.3,0,0.06\n11,0,1.2,-1.0,0,0.5,0,0.03\n"
    "30,0.4,1.0,-1.2,0,0.3,0,0.06\n";

// $client, $emulator, $teach (client's common arguments) and $out; `say TEXT` types into the client
// that `start ARGUMENTS` began, `until_text TEXT` waits for its output, `until_ticks N` for ticks
// of the newest run.
constexpr char kHarness[] = R"(
ip link set lo up && ip route add 224.0.0.0/4 dev lo || exit 90
bus=udp:239.74.163.2:43113
start_deg=0,68.75,-57.3,0,28.65,0
teach="teach --bus $bus --out $out/set --set realtime.priority=0 --set realtime.lock_memory=false
  --set without=[arm_hold_s,arm_fault_s] --set control.watchdogs.arm_fault_s=5 --set control.watchdogs.arm_hold_s=1
  --set control.watchdogs.delay_hold_s=0.5"
emulators=""
arm() { $emulator "$@" >> $out/emulator.txt 2>&1 & emulators="$emulators $!"; }
start() {
  rm -f $out/in; mkfifo $out/in
  "$@" $client $teach --instruction "open the drawer" $more < $out/in > $out/log 2>&1 & pid=$!
  exec 3> $out/in
}
say() { echo "$1" >&3; }
until_text() {
  for i in $(seq 600); do
    grep -q "$1" $out/log && return 0
    kill -0 $pid 2>/dev/null || break
    sleep 0.05
  done
  grep -q "$1" $out/log || { echo "never said: $1"; cat $out/log; exit 91; }
}
until_ticks() {
  for i in $(seq 600); do
    run=$(ls -d $out/set/runs/* 2>/dev/null | tail -n 1)
    [ $(cat $run/ticks.csv.partial 2>/dev/null | wc -l) -ge $1 ] && return 0
    sleep 0.05
  done
  echo "never $1 ticks"; exit 92
}
more_ticks() {
  run=$(ls -d $out/set/runs/* | tail -n 1)
  until_ticks $(( $(cat $run/ticks.csv.partial | wc -l) + $1 ))
}
cameras="--camera base=synthetic --camera wrist=synthetic"
)";

struct Result {
  std::string text, out;
  int code = 0;
};

std::string Script(const std::string& name, const std::string& body, std::string* out) {
  *out = ::testing::TempDir() + "/teach_program_" + name;
  fs::remove_all(*out);
  fs::create_directories(*out);
  EXPECT_TRUE(WriteFileAtomically(*out + "/hand.csv", kHand).ok());
  EXPECT_TRUE(
      WriteFileAtomically(*out + "/script.sh",
                          absl::StrCat("out=", *out, "; client=" ROBOT_CLIENT,
                                       "; emulator=" PIPER_EMULATOR, "\n", kHarness, body,
                                       "\ncode=$?\nkill $emulators 2>/dev/null\nwait 2>/dev/null\n"
                                       "exit $code\n"))
          .ok());
  return *out + "/script.sh";
}

Result InNamespace(const std::string& name, const std::string& body,
                   const char* unshare = "unshare -rn") {
  Result result;
  const std::string script = Script(name, body, &result.out);
  std::tie(result.text, result.code) =
      RunProgram(absl::StrCat("timeout 120 ", unshare, " bash ", script), "");
  return result;
}

bool HasNamespaces() { return RunProgram("unshare -rn true", "").second == 0; }
#define NEED_NAMESPACES() \
  if (!HasNamespaces()) GTEST_SKIP() << "no network namespace (unshare -rn) on this system"

LiberoColumns ColumnsOf(const std::string& file) {
  const auto opened = LiberoDemonstrationFile::Open(file);
  EXPECT_TRUE(opened.ok()) << opened.status();
  if (!opened.ok()) return {};
  EXPECT_TRUE(opened->absolute_actions());
  return opened->ReadColumns(0).value_or(LiberoColumns{});
}

TEST(TeachProgramTest, AHandsDemonstrationsAreReadBack) {
  NEED_NAMESPACES();
  const Result r = InNamespace("hand", R"(
arm --bus $bus --start-deg $start_deg --teach 0 --hand $out/hand.csv
more=$cameras; start
until_text "0 there"; say enable; until_text "gets no command"
until_ticks 20; say record; until_text "recording demonstration 0"; more_ticks 75; say success
until_text "demonstration 0 saved"
say record; until_text "recording demonstration 1"; more_ticks 45; say success
until_text "demonstration 1 saved"
say record; until_text "recording demonstration 2"; more_ticks 10; say discard; until_text dropped
say quit; wait $pid; code=$?; cat $out/log; (exit $code)
)");
  ASSERT_EQ(r.code, 0) << r.text;
  EXPECT_THAT(r.text, AllOf(HasSubstr("pictures at most"), Not(HasSubstr("ENABLED"))));
  const LiberoColumns columns = ColumnsOf(r.out + "/set/libero/episode_000000.hdf5");
  ASSERT_GE(columns.steps, 60);
  double most = -1, least = 1;
  for (int64_t t = 0; t < columns.steps; ++t) {
    most = std::max(most, columns.joint_states[7 * t]);
    least = std::min(least, columns.joint_states[7 * t]);
    const int64_t next = std::min(t + 1, columns.steps - 1);
    for (int i = 0; i < 7; ++i)
      EXPECT_EQ(columns.actions[7 * t + i], columns.joint_states[7 * next + i]) << t;
    // The hand's J2 is 1.2 - J1 / 2, whenever it was.
    EXPECT_NEAR(columns.joint_states[7 * t + 1], 1.2 - columns.joint_states[7 * t] / 2, 0.04);
  }
  EXPECT_NEAR(most, 0.4, 0.04);
  EXPECT_NEAR(least, 0, 0.04);
  EXPECT_TRUE(fs::exists(r.out + "/set/runs/000/DONE"));
  if (!ReaderFailure().empty()) GTEST_SKIP() << "not read back: " << ReaderFailure();
  const auto [output, code] = ReadBack(r.out + "/set/lerobot");
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, AllOf(HasSubstr("episode 0: 'open the drawer'"), HasSubstr("episode 1:"),
                            Not(HasSubstr("episode 2:"))));
}

TEST(TeachProgramTest, AFollowerIsRecordedWithItsLeadersTargets) {
  NEED_NAMESPACES();
  const Result r = InNamespace("leader", R"(
arm --bus $bus --start-deg $start_deg
arm --bus udp:239.74.163.2:43114 --start-deg $start_deg --leader --hand $out/hand.csv
more="$cameras --by leader:udp:239.74.163.2:43114"; start
until_text "0 there"; say record; until_text "follows nobody"
say enable; until_text "has power"; say follow; until_text "the arm follows"
for i in $(seq 100); do say record; sleep 0.1; grep -q "recording demonstration 0" $out/log && break; done
more_ticks 70; say success; until_text "demonstration 0 saved"
say ""; until_text "ENABLED .operator"; say quit; wait $pid; code=$?; cat $out/log; (exit $code)
)");
  ASSERT_EQ(r.code, 0) << r.text;
  const LiberoColumns columns = ColumnsOf(r.out + "/set/libero/episode_000000.hdf5");
  ASSERT_GE(columns.steps, 60);
  // Actions lead: shifted by a few ticks they are the states.
  const auto apart = [&](int64_t shift) {
    double sum = 0;
    for (int64_t t = shift; t < columns.steps; ++t)
      sum += std::pow(columns.joint_states[7 * t] - columns.actions[7 * (t - shift)], 2);
    return sum / static_cast<double>(columns.steps - shift);
  };
  int64_t best = 0;
  for (int64_t shift = 1; shift < 20; ++shift) best = apart(shift) < apart(best) ? shift : best;
  EXPECT_GE(best, 1) << r.text;
}

TEST(TeachProgramTest, AKilledClientLosesTheDemonstrationUnderWayAndNoOther) {
  NEED_NAMESPACES();
  const Result r = InNamespace("killed", R"(
arm --bus $bus --start-deg $start_deg --teach 0 --hand $out/hand.csv
more=$cameras; start
until_ticks 20; say record; until_text "recording demonstration 0"; more_ticks 20; say success
until_text "demonstration 0 saved"
say record; until_text "recording demonstration 1"; more_ticks 20
kill -9 $pid; wait $pid 2>/dev/null
start; until_text "1 there"; until_ticks 20; say record
until_text "recording demonstration 1"; more_ticks 20; say success; until_text "demonstration 1 saved"
exec 3>&-; wait $pid; code=$?; cat $out/log; (exit $code)
)");
  ASSERT_EQ(r.code, 0) << r.text;
  for (const char* file : {"libero/episode_000000.hdf5", "libero/episode_000001.hdf5"})
    EXPECT_GE(ColumnsOf(r.out + "/set/" + file).steps, 15) << file;
  EXPECT_FALSE(fs::exists(r.out + "/set/libero/episode_000002.hdf5"));
  EXPECT_TRUE(fs::exists(r.out + "/set/runs/001/DONE")) << "the end of input ends the run";
}

TEST(TeachProgramTest, AFullDiskIsSaidAndWhatWasSavedStays) {
  if (RunProgram("unshare -rnm mount -t tmpfs tmpfs /mnt", "").second != 0)
    GTEST_SKIP() << "no mount namespace (unshare -rnm) on this system";
  const Result r = InNamespace("full", R"(
mkdir $out/set; mount -t tmpfs -o size=6m tmpfs $out/set || exit 93
arm --bus $bus --start-deg $start_deg --teach 0 --hand $out/hand.csv
more=$cameras; start
until_ticks 20; say record; until_text "recording demonstration 0"; more_ticks 15; say success
until_text "demonstration 0 saved"
say record; until_text "recording demonstration 1"; more_ticks 120; say success
until_text "nothing was saved"
say quit; wait $pid; code=$?; cat $out/log; cp -r $out/set $out/copy; (exit $code)
)",
                               "unshare -rnm");
  EXPECT_LE(r.code, 1) << "the disk may have been full for the run's record too: " << r.text;
  EXPECT_THAT(r.text, AllOf(HasSubstr("free some space"), Not(HasSubstr("Segmentation"))));
  EXPECT_GE(ColumnsOf(r.out + "/copy/libero/episode_000000.hdf5").steps, 10);
  EXPECT_FALSE(fs::exists(r.out + "/copy/libero/episode_000001.hdf5"));
}

// A person at a terminal.
class Person {
 public:
  explicit Person(const std::string& command) {
    pid_ = forkpty(&terminal_, nullptr, nullptr, nullptr);
    if (pid_ == 0) {
      execl("/bin/sh", "sh", "-c", command.c_str(), nullptr);
      _exit(127);
    }
  }
  ~Person() {
    HangUp();
    if (pid_ > 0) kill(pid_, SIGKILL);
    if (pid_ > 0) waitpid(pid_, nullptr, 0);
  }
  void Type(const std::string& text) {
    EXPECT_EQ(write(terminal_, text.data(), text.size()), static_cast<ssize_t>(text.size()));
  }
  // Reads until the terminal shows `text` behind what was waited for before.
  bool Sees(const std::string& text, int seconds = 40) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(seconds);
    while (true) {
      if (const size_t at = shown_.find(text, seen_); at != std::string::npos) {
        seen_ = at + text.size();
        return true;
      }
      if (std::chrono::steady_clock::now() > end || !Read(50)) return false;
    }
  }
  // A key that is held down for so long: its repetitions 30 times a second.
  void Hold(const std::string& key, int repetitions) {
    for (int i = 0; i < repetitions; ++i) {
      Type(key);
      Read(33);
    }
  }
  bool Raw() const {
    termios now;
    EXPECT_EQ(tcgetattr(terminal_, &now), 0);
    return (now.c_lflag & ICANON) == 0;
  }
  void HangUp() {
    if (terminal_ >= 0) close(terminal_);
    terminal_ = -1;
  }
  int Wait() {
    while (terminal_ >= 0 && Read(1000)) {
    }
    int status = 0;
    waitpid(pid_, &status, 0);
    pid_ = -1;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  const std::string& shown() const { return shown_; }

 private:
  bool Read(int timeout_ms) {  // false: nobody writes any more
    pollfd wait{terminal_, POLLIN, 0};
    if (poll(&wait, 1, timeout_ms) <= 0) return true;
    char bytes[4096];
    const ssize_t count = read(terminal_, bytes, sizeof bytes);
    if (count <= 0) return false;
    shown_.append(bytes, static_cast<size_t>(count));
    return true;
  }
  pid_t pid_ = -1;
  int terminal_ = -1;
  std::string shown_;
  size_t seen_ = 0;
};

constexpr char kAtKeyboard[] = R"(
arm --bus $bus --start-deg $start_deg
$client $teach --by keyboard --instruction "open the drawer" $cameras
)";

TEST(TeachProgramTest, KeysMoveTheToolAndTheTerminalIsAsItWasAfterwards) {
  NEED_NAMESPACES();
  std::string out;
  const std::string script = Script("keyboard", kAtKeyboard, &out);
  Person person("unshare -rn bash " + script);
  ASSERT_TRUE(person.Sees("0 there")) << person.shown();
  EXPECT_FALSE(person.Raw());
  person.Type("enable\r");
  ASSERT_TRUE(person.Sees("has power")) << person.shown();
  person.Type("follow\r");
  ASSERT_TRUE(person.Sees("the arm follows")) << person.shown();
  while (!person.Raw()) person.Hold("", 1);
  person.Type("R");
  ASSERT_TRUE(person.Sees("recording demonstration 0")) << person.shown();
  person.Hold("r", 30);
  person.Hold("h", 15);
  person.Hold("", 20);
  person.Type("S");
  ASSERT_TRUE(person.Sees("demonstration 0 saved")) << person.shown();
  person.Type("\r");
  ASSERT_TRUE(person.Sees("lines again")) << person.shown();
  EXPECT_FALSE(person.Raw());
  person.Type("quit\r");
  EXPECT_EQ(person.Wait(), 0) << person.shown();
  const LiberoColumns columns = ColumnsOf(out + "/set/libero/episode_000000.hdf5");
  ASSERT_GE(columns.steps, 30);
  const int64_t last = columns.steps - 1;
  EXPECT_NEAR(columns.ee_pos[3 * last + 2] - columns.ee_pos[2], 0.1, 0.05) << "a second of r";
  EXPECT_NEAR(columns.ee_pos[3 * last] - columns.ee_pos[0], 0, 0.01);
  EXPECT_LT(columns.joint_states[7 * last + 6], columns.joint_states[6] + 1e-3) << "h closes";
}

TEST(TeachProgramTest, AClosedTerminalHoldsTheArmAndEndsTheRun) {
  NEED_NAMESPACES();
  std::string out;
  // The client's parent ignores the hang-up, so that it can say how the client ended.
  const std::string script = Script("hangup",
                                    std::string("trap '' HUP\n") +
                                        R"(arm --bus $bus --start-deg $start_deg
bash -c 'trap - HUP; exec "$@"' x $client $teach --by keyboard --instruction "open the drawer"
echo $? > $out/code.part; mv $out/code.part $out/code
)",
                                    &out);
  Person person("unshare -rn bash " + script);
  ASSERT_TRUE(person.Sees("0 there")) << person.shown();
  person.Type("enable\r");
  ASSERT_TRUE(person.Sees("has power")) << person.shown();
  person.Type("follow\r");
  ASSERT_TRUE(person.Sees("the arm follows")) << person.shown();
  while (!person.Raw()) person.Hold("", 1);
  person.Type("R");
  ASSERT_TRUE(person.Sees("recording demonstration 0")) << person.shown();
  person.Hold("w", 20);
  person.HangUp();
  for (int i = 0; i < 600 && !fs::exists(out + "/code"); ++i) usleep(50'000);
  EXPECT_EQ(ReadFile(out + "/code").value_or("none"), "0\n");
  EXPECT_TRUE(fs::exists(out + "/set/runs/000/DONE"));
  EXPECT_FALSE(fs::exists(out + "/set/lerobot/meta/info.json")) << "nobody said success";
  const std::string events = ReadFile(out + "/set/runs/000/events.jsonl").value_or("");
  const size_t moved = events.rfind("\"MOVE\"");
  ASSERT_NE(moved, std::string::npos) << events;
  EXPECT_NE(events.find("\"state\":\"ENABLED\"", moved) & events.find("\"state\":\"HOLD\"", moved),
            std::string::npos)
      << "it stopped: " << events;
}

TEST(TeachProgramTest, RefusesWhatMakesNoSenseWithARemedy) {
  const std::string out = ::testing::TempDir() + "/teach_program_refused";
  fs::remove_all(out);
  const std::string base = "teach --out " + out + " ";
  for (const auto& [arguments, remedy] :
       {std::pair{std::string(""), "give --instruction"},
        std::pair{std::string("--instruction x --by foot"), "leader:can:can1"},
        std::pair{std::string("--instruction x --bus can:can0 --by leader:can:can0"),
                  "a bus of its own"},
        std::pair{std::string("--instruction x --by keyboard < /dev/null"), "needs a terminal"},
        std::pair{std::string("--instruction x --by gamepad:/dev/none --bus rehearse"),
                  "plug it in"},
        std::pair{std::string("--instruction x --speed 3"), "at most 0.25"}}) {
    const auto [text, code] =
        RunProgram(std::string("timeout 20 ") + ROBOT_CLIENT, base + arguments);
    EXPECT_EQ(code, 2) << text;
    EXPECT_THAT(text, HasSubstr(remedy)) << arguments;
  }
  const auto [text, code] =
      RunProgram("bash", "-c \"" ROBOT_CLIENT
                         " --bus rehearse --set "
                         "realtime.priority=0 --set realtime.lock_memory=false --out " +
                             out + "/run < <(printf 'record\\nquit\\n')\"");
  EXPECT_THAT(text, HasSubstr("robot_client teach"));
}

}  // namespace
}  // namespace robostress
