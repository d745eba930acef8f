// The manifest that a sweep writes for Kubernetes: its structure, and its pods run here as
// processes.

#include <filesystem>
#include <map>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/str_replace.h"
#include "common/child_process.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/grid_programs.h"
#include "tests/eval/synthetic_run.h"
#include "yaml-cpp/yaml.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

class Kubernetes : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = TestFolder();
    const auto [code, text] =
        RunGrid(folder_, "sweep",
                SmallGrid() +
                    "--launcher kubernetes --workers 2 --max-tasks 3 --split-episodes 4 "
                    "--servers 2 --out '" +
                    folder_ + "/run'");
    ASSERT_EQ(code, 0) << text;
    EXPECT_THAT(text, HasSubstr("kubectl apply -f"));
    jobs_ = YAML::LoadAllFromFile(folder_ + "/run/submissions/0001/kubernetes.yaml");
  }
  YAML::Node Job(const std::string& component) const {
    for (const YAML::Node& job : jobs_) {
      if (job["metadata"]["labels"]["app.kubernetes.io/component"].as<std::string>() == component)
        return job;
    }
    return YAML::Node();
  }
  // A pod's command line with the variables that Kubernetes would have set.
  static std::vector<std::string> Pod(const YAML::Node& job, int index) {
    const YAML::Node container = job["spec"]["template"]["spec"]["containers"][0];
    std::vector<std::string> command = {std::string(BIN_DIR) + "/" +
                                        container["command"][0].as<std::string>()};
    for (const YAML::Node& argument : container["args"]) {
      command.push_back(absl::StrReplaceAll(
          argument.as<std::string>(),
          {{"$(JOB_COMPLETION_INDEX)", absl::StrCat(index)}, {"$(POD_IP)", "127.0.0.1"}}));
    }
    return command;
  }
  std::string folder_;
  std::vector<YAML::Node> jobs_;
};

TEST_F(Kubernetes, ManifestIsOfIndexedJobsThatShareOneVolume) {
  ASSERT_EQ(jobs_.size(), 3u);
  std::set<std::string> names;
  for (const YAML::Node& job : jobs_) {
    EXPECT_EQ(job["apiVersion"].as<std::string>(), "batch/v1");
    EXPECT_EQ(job["kind"].as<std::string>(), "Job");
    const std::string name = job["metadata"]["name"].as<std::string>();
    EXPECT_TRUE(names.insert(name).second) << name;
    EXPECT_LE(name.size(), 63u);
    for (const char c : name)
      EXPECT_TRUE(absl::ascii_islower(c) || absl::ascii_isdigit(c) || c == '-') << name;
    const YAML::Node spec = job["spec"];
    EXPECT_EQ(spec["completionMode"].as<std::string>(), "Indexed");
    EXPECT_LE(spec["parallelism"].as<int>(), spec["completions"].as<int>());
    // backoffLimitPerIndex is only allowed with restartPolicy Never.
    const YAML::Node pod = spec["template"]["spec"];
    EXPECT_EQ(pod["restartPolicy"].as<std::string>(), "Never");
    EXPECT_GT(spec["backoffLimitPerIndex"].as<int>(), 0);
    EXPECT_EQ(spec["podFailurePolicy"]["rules"][0]["action"].as<std::string>(), "Ignore");
    EXPECT_EQ(spec["podFailurePolicy"]["rules"][0]["onPodConditions"][0]["type"].as<std::string>(),
              "DisruptionTarget");
    const YAML::Node container = pod["containers"][0];
    const YAML::Node mount = container["volumeMounts"][0];
    EXPECT_EQ(mount["name"].as<std::string>(), pod["volumes"][0]["name"].as<std::string>());
    EXPECT_EQ(mount["mountPath"].as<std::string>() + "/run", folder_ + "/run");
    EXPECT_EQ(pod["volumes"][0]["persistentVolumeClaim"]["claimName"].as<std::string>(),
              "robostress-runs");
    std::set<std::string> variables = {"JOB_COMPLETION_INDEX"};  // of every indexed Job
    for (const YAML::Node& entry : container["env"])
      variables.insert(entry["name"].as<std::string>());
    for (const YAML::Node& argument : container["args"]) {
      const std::string text = argument.as<std::string>();
      const bool variable = text.rfind("$(", 0) == 0;
      EXPECT_TRUE(!variable || variables.count(text.substr(2, text.size() - 3)) == 1) << text;
    }
  }
  EXPECT_EQ(Job("work")["spec"]["completions"].as<int>(), 3);
  EXPECT_EQ(Job("work")["spec"]["parallelism"].as<int>(), 2);
  EXPECT_EQ(Job("serve")["spec"]["completions"].as<int>(), 2);
}

TEST_F(Kubernetes, ItsPodsMakeTheTableOfALocalSweep) {
  const std::map<std::string, std::string> environment = {{"ROBOSTRESS_BIN", FAKE_PROGRAMS}};
  std::vector<ChildProcess> background;
  const auto start = [&](const YAML::Node& job, int index) {
    absl::StatusOr<ChildProcess> pod =
        ChildProcess::Start(Pod(job, index), environment, folder_ + "/pods.log");
    ASSERT_TRUE(pod.ok()) << pod.status();
    background.push_back(*std::move(pod));
  };
  for (int index = 0; index < 3; ++index) start(Job("work"), index);
  start(Job("serve"), 0);
  start(Job("serve"), 1);
  start(Job("merge"), 0);
  // Those that work first: the others wait for them, for ever if one has failed.
  for (ChildProcess& pod : background)
    ASSERT_EQ(pod.WaitForEnd().code, 0) << *ReadFile(folder_ + "/pods.log");
  const auto [code, text] =
      RunGrid(folder_, "sweep", SmallGrid() + "--no-report --out '" + folder_ + "/local'");
  ASSERT_EQ(code, 0) << text;
  EXPECT_EQ(*ReadFile(folder_ + "/run/episodes.csv"), *ReadFile(folder_ + "/local/episodes.csv"));
  EXPECT_TRUE(fs::exists(folder_ + "/run/report.html"));
}

// No server ever answers. Kubernetes gives an index up after seven pods; the merge must not wait
// on.
TEST_F(Kubernetes, WhatItGivesUpIsNotWaitedFor) {
  const auto run = [&](std::vector<std::string> command) {
    absl::StatusOr<ChildProcess> pod =
        ChildProcess::Start(command, {{"ROBOSTRESS_BIN", FAKE_PROGRAMS}}, folder_ + "/pods.log");
    EXPECT_TRUE(pod.ok()) << pod.status();
    return pod->WaitForEnd().code;
  };
  const int pods = Job("work")["spec"]["backoffLimitPerIndex"].as<int>() + 1;
  const auto left = [&] {
    std::error_code none;
    return std::distance(fs::directory_iterator(folder_ + "/run/submissions/0001/left", none),
                         fs::directory_iterator());
  };
  for (int index = 0; index < 3; ++index) {
    std::vector<std::string> work = Pod(Job("work"), index);
    work.insert(work.end(), {"--patience", "0"});
    for (int pod = 0; pod < pods; ++pod) {
      EXPECT_EQ(left(), index) << "before pod " << pod;
      EXPECT_EQ(run(work), 75) << *ReadFile(folder_ + "/pods.log");
    }
  }
  EXPECT_EQ(left(), 3);
  EXPECT_EQ(run(Pod(Job("merge"), 0)), 1);
  EXPECT_THAT(*ReadFile(folder_ + "/pods.log"), HasSubstr("not done: "));
}

TEST_F(Kubernetes, ARunDirectoryOutsideTheVolumeIsRefused) {
  const auto [code, text] = RunGrid(
      folder_, "sweep",
      SmallGrid() + "--launcher kubernetes --claim-mount /elsewhere --out '" + folder_ + "/other'");
  EXPECT_EQ(code, 2);
  EXPECT_THAT(text, HasSubstr("not under --claim-mount"));
}

}  // namespace
}  // namespace robostress
