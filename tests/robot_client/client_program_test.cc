// The program as a person uses it: a rehearsal against a server of joint targets, in real time, so
// every bound on time is generous.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

// Runs `body` with $client, $out (empty) and $server (pid $server_pid) in the environment.
std::pair<std::string, int> WithServer(const std::string& name, const std::string& body,
                                       std::string* out) {
  *out = ::testing::TempDir() + "/client_program_" + name;
  std::filesystem::remove_all(*out);
  std::filesystem::create_directories(*out);
  const std::string script = absl::StrCat(
      "out=", *out, "; client=" ROBOT_CLIENT, "\n", JOINT_POLICY_SERVER,
      " > $out/server.txt & server_pid=$!\n",
      "for i in $(seq 200); do server=$(sed -n 's/^joint_policy_server: //p' $out/server.txt)\n",
      "  [ -n \"$server\" ] && break; sleep 0.1; done\n",
      "common=\"--bus rehearse --server $server --policy sway --instruction sway --camera "
      "base=synthetic --camera wrist=synthetic --out $out/run --set realtime.priority=0 --set "
      "realtime.lock_memory=false --without arm_fault_s --set control.watchdogs.arm_fault_s=20 "
      "--without arm_hold_s --set control.watchdogs.arm_hold_s=10\"\n",
      body, "\ncode=$?\nkill $server_pid 2>/dev/null\nwait 2>/dev/null\nexit $code\n");
  EXPECT_TRUE(WriteFileAtomically(*out + "/script.sh", script).ok());
  return RunProgram("bash", *out + "/script.sh");
}

std::string Text(const std::string& file) {
  const absl::StatusOr<std::string> text = ReadFile(file);
  EXPECT_TRUE(text.ok()) << text.status();
  return text.ok() ? *text : "";
}

TEST(ClientProgramTest, RehearsesWholeEpisodesAndLeavesAWholeRecording) {
  std::string out;
  const auto [text, code] =
      WithServer("rehearsal",
                 "$client $common --automatic --set episodes=2 --set episode_s=1 --set "
                 "record_pictures=true",
                 &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_TRUE(DecodePng(Text(out + "/run/pictures/000001_wrist.png")).ok());
  EXPECT_THAT(Text(out + "/run/ticks.csv"), AllOf(HasSubstr("policy_J1"), HasSubstr(",RUN,")));
  EXPECT_THAT(Text(out + "/run/frames.csv"), AllOf(HasSubstr("age_ms"), HasSubstr(",shown,")));
  EXPECT_THAT(Text(out + "/run/episodes.jsonl"),
              AllOf(HasSubstr("\"episode\":1"), HasSubstr("\"sessions\":1")));
  EXPECT_THAT(Text(out + "/run/timing.json"), HasSubstr("wake_histogram"));
  EXPECT_TRUE(std::filesystem::exists(out + "/run/DONE"));
  EXPECT_FALSE(std::filesystem::exists(out + "/run/ticks.csv.partial"));
}

TEST(ClientProgramTest, RefusesCamerasWhosePicturesNobodyCouldTellApart) {
  const auto [text, code] =
      RunProgram(ROBOT_CLIENT,
                 "--bus rehearse --camera side/1=synthetic --camera side:1=synthetic --out none");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("cameras has 'side:1' twice"));
}

TEST(ClientProgramTest, ShowsCamerasInABrowserAndRefusesWhatMakesNoSense) {
  const auto [shown, code] = RunProgram(
      "timeout 20 " ROBOT_CLIENT,
      "cameras --preview 127.0.0.1:0 --camera base=synthetic --camera wrist=synthetic --seconds 1");
  EXPECT_EQ(code, 0) << shown;
  EXPECT_THAT(shown, HasSubstr("2 cameras on http://127.0.0.1:"));
  for (const auto& [arguments, remedy] :
       {std::pair{"cameras --camera base=synthetic", "add --preview 127.0.0.1:8090"},
        std::pair{"cameras --preview 0.0.0.0:0 --camera base=synthetic", "--anywhere"},
        std::pair{"cameras --preview 127.0.0.1:0 --camera base=v4l2:/dev/none", "by-id"}}) {
    const auto [output, refused] = RunProgram("timeout 20 " ROBOT_CLIENT, arguments);
    EXPECT_EQ(refused, 2) << arguments;
    EXPECT_THAT(output, HasSubstr(remedy));
  }
}

TEST(ClientProgramTest, MonitorSaysWhatItCannotLookAt) {
  const std::string config = ::testing::TempDir() + "/client_program_rehearse.yaml";
  ASSERT_TRUE(WriteFileAtomically(config, "bus: rehearse\n").ok());
  for (const auto& [arguments, remedy] :
       {std::pair{std::string("--bus can:no_such_if --once"), "can:no_such_if"},
        std::pair{std::string("--bus uart:1"), "expected can:INTERFACE or udp:GROUP:PORT"},
        std::pair{"--config " + config, "bus is rehearse, where there is no arm to look at"},
        std::pair{"--bus can:can0 --config " + config, "--config"},
        std::pair{std::string("--seconds 0"), "--seconds"}}) {
    const auto [output, code] = RunProgram("timeout 20 " ROBOT_CLIENT, "monitor " + arguments);
    EXPECT_EQ(code, 2) << arguments << output;
    EXPECT_THAT(output, HasSubstr(remedy));
  }
  const auto [help, code] = RunProgram(ROBOT_CLIENT, "monitor --help");
  EXPECT_EQ(code, 0);
  EXPECT_THAT(help, HasSubstr("It never commands"));
}

TEST(ClientProgramTest, HoldsWhenTheServerIsKilledAndSaysWhy) {
  std::string out;
  const auto [text, code] =
      WithServer("killed",
                 "(sleep 1.5; kill -9 $server_pid) & $client $common --automatic --set episodes=1 "
                 "--set episode_s=3 --set control.watchdogs.server_hold_s=0.5",
                 &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(Text(out + "/run/events.jsonl"), HasSubstr("\"cause\":\"server_silent\""));
  EXPECT_THAT(text, HasSubstr("HOLD (server_silent)"));
  EXPECT_THAT(text, HasSubstr("the server's last error: "));
}

TEST(ClientProgramTest, ObeysAPerson) {
  std::string out;
  const auto [text, code] = WithServer("person",
                                       "(sleep 1; echo enable; sleep 0.6; echo start; sleep 0.8; "
                                       "echo; sleep 0.6; echo resume; sleep "
                                       "0.6; echo success; sleep 0.5; echo quit) | $client $common",
                                       &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr("RUN (operator)"), HasSubstr("HOLD (operator)"),
                          HasSubstr("the episode goes on"), HasSubstr("episode ended")));
  EXPECT_THAT(Text(out + "/run/episodes.jsonl"), HasSubstr("\"success\":true"));
}

// Every command is answered before the next line is read, so nothing here depends on time.
TEST(ClientProgramTest, DrivesHomeWhereAPersonHasConfiguredIt) {
  std::string out;
  const auto [text, code] = WithServer(
      "home",
      "printf 'enable\\nhome\\nstart\\njog J1 2deg\\nsuccess\\nquit\\n' | $client $common --set "
      "'home=[0.2, 1.0, -0.8, 0.0, 0.4, 0.0, 0.06]'",
      &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr("the arm is home"), HasSubstr("episode 0 of task 0"),
                          HasSubstr("the client is RUN and an episode runs; end it first")));
  EXPECT_THAT(Text(out + "/run/episodes.jsonl"),
              AllOf(HasSubstr("\"episode\":0"), Not(HasSubstr("\"episode\":-1"))));
}

TEST(ClientProgramTest, StartsNoPolicyWhileTheArmIsOutOfItsWorkspace) {
  std::string out;
  const auto [text, code] = WithServer("outside",
                                       "printf 'enable\\nstart\\nquit\\n' | $client $common --set "
                                       "'control.workspace.upper=[0.2, 0.5, 1.0]'",
                                       &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr("refused: start: the client is ENABLED; the arm is "),
                          HasSubstr(" mm into the workspace box: a policy runs only inside"),
                          HasSubstr("control.workspace"), Not(HasSubstr("RUN"))));
}

TEST(ClientProgramTest, HasNoHomeUnlessToldWhereItIs) {
  std::string out;
  const auto [text, code] =
      WithServer("homeless", "printf 'enable\\nhome\\nquit\\n' | $client $common", &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, HasSubstr("refused: no starting pose is configured"));
  const auto [refused, bad] = RunProgram(
      ROBOT_CLIENT, "--server 127.0.0.1:1 --instruction x --set home=[1,2] --out " + out + "/no");
  EXPECT_EQ(bad, 2);
  EXPECT_THAT(refused, HasSubstr("home has 2 numbers"));
}

TEST(ClientProgramTest, ASignalHolds) {
  std::string out;
  const auto [text, code] = WithServer("signal",
                                       "$client $common --automatic --set episodes=1 --set "
                                       "episode_s=3 & pid=$!; sleep 1.5; kill -INT "
                                       "$pid; wait $pid",
                                       &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, HasSubstr("HOLD (operator)"));
}

TEST(ClientProgramTest, NeedsNoServerToEnableJogAndDriveHome) {
  const std::string out = ::testing::TempDir() + "/client_program_alone";
  std::filesystem::remove_all(out);
  std::filesystem::create_directories(out);
  const auto [text, code] = RunProgram(
      "bash",
      "-c \"printf 'enable\\njog J3 5deg\\nhome\\nstart\\nquit\\n' | " ROBOT_CLIENT
      " --bus rehearse --set realtime.priority=0 --set realtime.lock_memory=false --without "
      "arm_fault_s --set control.watchdogs.arm_fault_s=20 --without arm_hold_s --set "
      "control.watchdogs.arm_hold_s=10 --set 'home=[0.1, 1.2, -1.0, 0.0, 0.5, 0.0, 0.06]' --out " +
          out + "/run\"");
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr("the arm is there"), HasSubstr("the arm is home"),
                          HasSubstr("no policy server is configured")));
  EXPECT_THAT(Text(out + "/run/ticks.csv"), HasSubstr(",MOVE,"));
}

TEST(ClientProgramTest, ATerminationHoldsAndLeavesTheArmWithItsPower) {
  std::string out;
  const auto [text, code] = WithServer("terminated",
                                       "$client $common --automatic --set episodes=1 --set "
                                       "episode_s=30 & pid=$!; sleep 1.5; kill -TERM $pid; kill "
                                       "-TERM $pid; wait $pid",
                                       &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr("HOLD (operator)"), Not(HasSubstr("quick_stop"))));
  EXPECT_TRUE(std::filesystem::exists(out + "/run/DONE"));
}

// Types into a client of its own until the body ends; `says TEXT` waits for its output.
constexpr char kTyped[] = R"(
mkfifo $out/in
$client $common --set home_velocity=1 --set 'home=[2.0, 1.0, -0.8, 0.0, 0.4, 0.0, 0.06]' < $out/in > $out/log 2>&1 &
pid=$!
exec 3> $out/in
says() { for i in $(seq 400); do grep -q "$1" $out/log && return; sleep 0.05; done; echo "never: $1"; }
echo enable >&3; says "has power"
)";

// What a last command leaves behind: a target that the arm stands at, or a sudden stop.
double LastStep(const std::string& out) {
  const std::vector<std::string> rows =
      absl::StrSplit(Text(out + "/run/ticks.csv"), '\n', absl::SkipEmpty());
  const std::vector<std::string> names = absl::StrSplit(rows[0], ',');
  const auto column = std::find(names.begin(), names.end(), "sent_J1") - names.begin();
  const auto sent = [&](size_t back) {
    const std::vector<std::string> row = absl::StrSplit(rows[rows.size() - back], ',');
    return std::stod(row[static_cast<size_t>(column)]);
  };
  return std::abs(sent(1) - sent(2));
}

TEST(ClientProgramTest, ATerminationOnTheWayBrakesFirst) {
  std::string out;
  const auto [text, code] =
      WithServer("brakes",
                 absl::StrCat(kTyped,
                              "echo home >&3; says MOVE; sleep 1.2; kill -TERM $pid; wait "
                              "$pid; code=$?; cat $out/log; (exit $code)"),
                 &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr("MOVE (operator)"), Not(HasSubstr("(arrived)"))));
  EXPECT_LT(LastStep(out), 1e-6);
}

TEST(ClientProgramTest, AnInputThatEndsOnTheWayHolds) {
  std::string out;
  const auto [text, code] = WithServer(
      "hung_up",
      absl::StrCat(kTyped,
                   "echo home >&3; says MOVE; sleep 0.5; exec 3>&-; says 'home was stopped'; kill "
                   "-TERM $pid; wait $pid; code=$?; cat $out/log; (exit $code)"),
      &out);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, AllOf(HasSubstr("the input has ended and nobody can type"),
                          HasSubstr("home was stopped"), Not(HasSubstr("never:"))));
}

TEST(ClientProgramTest, AClosedOutputEndsNothing) {
  std::string out;
  const auto [text, code] =
      WithServer("closed",
                 "{ $client $common --automatic --set episodes=1 --set episode_s=2; echo $? > "
                 "$out/code; } | head -n 1",
                 &out);
  EXPECT_EQ(Text(out + "/code"), "0\n") << text;
  EXPECT_TRUE(std::filesystem::exists(out + "/run/DONE"));
}

TEST(ClientProgramTest, RefusesBadInput) {
  const auto run = [](const std::string& arguments) {
    return RunProgram("timeout 60 " ROBOT_CLIENT,
                      arguments + " --out " + ::testing::TempDir() + "/refused");
  };
  auto [text, code] = run("--bus can:can0 --automatic --server 127.0.0.1:1 --instruction x");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("started by a person"));
  std::tie(text, code) = run("--server 127.0.0.1:1");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("--instruction"));
  std::tie(text, code) =
      run("--server 127.0.0.1:1 --instruction x --camera base=synthetic,fault=melt");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("unplug"));
  std::tie(text, code) = run("--set control.rate=30");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("rate_hz"));
  for (const char* wrong : {"control.watchdogs.following_error=.inf", "home_velocity=3",
                            "control.watchdogs.server_hold_s=1e9", "collision_level=9",
                            "control.watchdogs.camera_hold_s=-1", "control.press.excess=[1]",
                            "control.press.excess_s=1e9", "control.press.payload_kg=50",
                            "control.press.blocked_error=1e9", "control.press.blocked_s=1e9",
                            "control.press.blocked_travel=0", "control.rate_hz=1000",
                            "control.workspace.lower=[1,1,1]"}) {
    std::tie(text, code) = run(absl::StrCat("--set ", wrong));
    EXPECT_EQ(code, 2) << wrong;
    const std::string key(absl::string_view(wrong).substr(0, std::string(wrong).find('=')));
    EXPECT_THAT(text, HasSubstr(key.substr(key.rfind('.') + 1))) << text;
  }
  std::tie(text, code) = run("--set home=[0,2.2,-1.0,0,1.0,0,0]");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("home lies")) << "below the table";
  EXPECT_EQ(RunProgram(ROBOT_CLIENT, "--help").second, 0);
}

// Robot file, configuration and --set, each over those before, field by field: the table is the
// file's, the margin the configuration's. Nothing listens there, and a table that high is refused
// before anybody is asked.
TEST(ClientProgramTest, ARobotFilesWorkspaceStandsWhereTheConfigurationSaysNothing) {
  const std::string out = ::testing::TempDir() + "/client_program_robot";
  std::filesystem::create_directories(out);
  const std::string bridge = "tests/robot_client/bridge/";
  const std::string robot = out + "/robot.yaml", partial = out + "/partial.yaml";
  ASSERT_TRUE(WriteFileAtomically(
                  robot, absl::StrReplaceAll(
                             Text(bridge + "seven_modelled.yaml"),
                             {{"seven_joints.urdf",
                               std::filesystem::absolute(bridge + "seven_joints.urdf").string()},
                              {"table_z: 0.02", "table_z: 2"}}))
                  .ok());
  ASSERT_TRUE(
      WriteFileAtomically(partial, absl::StrCat("bus: bridge:unix:/tmp/nobody\nrobot: ", robot,
                                                "\ncontrol: {workspace: {margin: 0.01}}\n"))
          .ok());
  const auto run = [&](const std::string& arguments) {
    return RunProgram("timeout 60 " ROBOT_CLIENT, arguments + " --out " + out + "/none");
  };
  auto [text, code] = run("--config " + partial);
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text,
              AllOf(HasSubstr(robot), HasSubstr("workspace.table_z is 2 m and margin 0.01 m")));
  std::tie(text, code) = run("--set bus=bridge:unix:/tmp/nobody --set robot=" + robot);
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("workspace.table_z is 2 m and margin 0 m"));
  std::tie(text, code) = run("--config " + partial + " --set control.workspace.table_z=0.02");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("no driver at unix:/tmp/nobody"));
}

// No server, no arm: replay and excite on the arm that is not there.
TEST(ClientProgramTest, PlaysAMotionSlowlyFirstAndRecordsIt) {
  const std::string out = ::testing::TempDir() + "/client_program_replay";
  std::filesystem::remove_all(out);
  std::filesystem::create_directories(out);
  std::string motion = "t,q_cmd_J1,q_cmd_J3\n";
  for (int i = 0; i <= 40; ++i)
    absl::StrAppend(&motion, 0.05 * i, ",", 0.1 * std::sin(M_PI * i / 20), ",-0.8\n");
  ASSERT_TRUE(WriteFileAtomically(out + "/motion.csv", motion).ok());
  const std::string common = absl::StrCat(
      "replay ", out,
      "/motion.csv --bus rehearse --set realtime.priority=0 --set "
      "realtime.lock_memory=false --without arm_fault_s --set control.watchdogs.arm_fault_s=20 "
      "--without arm_hold_s --set control.watchdogs.arm_hold_s=10 ");
  const auto [played, code] =
      RunProgram(ROBOT_CLIENT, absl::StrCat(common, "--automatic --out ", out, "/run"));
  EXPECT_EQ(code, 0) << played;
  EXPECT_THAT(played, AllOf(HasSubstr("play 0.25:"), HasSubstr("the motion is over"),
                            HasSubstr("play 1:")));
  EXPECT_TRUE(std::filesystem::exists(out + "/run/DONE"));
  EXPECT_THAT(Text(out + "/run/motion.csv"), HasSubstr("t,q_cmd_J1,q_cmd_J3\n0,0,-0.8\n"));
  EXPECT_THAT(Text(out + "/run/ticks.csv"), HasSubstr(",MOVE,"));

  const std::string orders = out + "/orders.sh";
  ASSERT_TRUE(WriteFileAtomically(
                  orders, absl::StrCat("printf 'play slow\\nenable\\nplay\\nstart\\nquit\\n' | ",
                                       ROBOT_CLIENT, " ", common, "--out ", out,
                                       "/refused; printf 'play 2\\nquit\\n' | ", ROBOT_CLIENT, " ",
                                       common, "--out ", out, "/wrong\n"))
                  .ok());
  const auto [refused, refused_code] = RunProgram("bash", orders);
  EXPECT_EQ(refused_code, 0) << refused;
  EXPECT_THAT(refused, AllOf(HasSubstr("the client is IDLE; the arm is moved from ENABLED"),
                             HasSubstr("was not played slowly yet; type play slow"),
                             HasSubstr("'play 0.5' (of its speed, 0.01 to 1)"),
                             HasSubstr("no policy server is configured")));

  const auto [again, again_code] = RunProgram(
      ROBOT_CLIENT,
      absl::StrCat("replay ", out, "/run --bus rehearse --episode 3 --out ", out, "/again"));
  EXPECT_EQ(again_code, 2);
  EXPECT_THAT(again, HasSubstr("ticks.csv: has no episode 3"));
}

TEST(ClientProgramTest, DesignsAMotionThatShowsWhatJointsHide) {
  const std::string out = ::testing::TempDir() + "/client_program_excite";
  std::filesystem::remove_all(out);
  std::filesystem::create_directories(out);
  const std::string orders = out + "/orders.sh";
  ASSERT_TRUE(
      WriteFileAtomically(orders, absl::StrCat("printf 'quit\\n' | ", ROBOT_CLIENT,
                                               " excite --bus rehearse --out ", out, "/run\n"))
          .ok());
  const auto [text, code] = RunProgram("bash", orders);
  EXPECT_EQ(code, 0) << text;
  EXPECT_THAT(text, HasSubstr("motion designed, seed 1, "));
  EXPECT_THAT(Text(out + "/run/motion.csv"),
              HasSubstr("t,q_cmd_J1,q_cmd_J2,q_cmd_J3,q_cmd_J4,q_cmd_J5,q_cmd_J6\n"));
  const auto [refused, refused_code] = RunProgram(
      ROBOT_CLIENT, absl::StrCat("excite --bus rehearse --set control.workspace.table_z=0.5 "
                                 "--out ",
                                 out, "/none"));
  EXPECT_EQ(refused_code, 2);
  EXPECT_THAT(refused, HasSubstr("(the table); move home away from it"));
}

}  // namespace
}  // namespace robostress
