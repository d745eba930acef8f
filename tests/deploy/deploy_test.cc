// What deploy/ says of the policy server fits the server and itself. A cluster's own schema is not
// at hand where tests run; systemd's checker is used where it is installed.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <map>
#include <regex>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "server/serve_options.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string Deploy(const std::string& file) {
  auto text = ReadFile(absl::StrCat(ROBOSTRESS_SOURCE_DIR, "/deploy/", file));
  EXPECT_TRUE(text.ok()) << text.status();
  return text.ok() ? *text : "";
}

ServeOptions Options(const std::string& name, const std::string& yaml) {
  const auto options = ParseConfig<ServeOptions>(name, yaml);
  EXPECT_TRUE(options.ok()) << options.status();
  return options.ok() ? *options : ServeOptions();
}

int PortOf(const std::string& listen) { return std::stoi(listen.substr(listen.rfind(':') + 1)); }

// The flags that the server has.
struct FlagNames {
  std::set<std::string> names = {"--config", "--print-config", "--help"};
  template <class T>
  void Field(std::string key, T&, const char*) {
    std::replace(key.begin(), key.end(), '_', '-');
    names.insert("--" + key);
  }
};
std::set<std::string> KnownFlags() {
  FlagNames flags;
  ServeOptions().Visit(flags);
  return flags.names;
}

TEST(Deploy, TheSampleConfigurationIsWhatTheServerReads) {
  const ServeOptions options = Options("serve.yaml", Deploy("serve.yaml"));
  for (const std::string& listen : {options.listen, options.websocket_listen, options.http_listen,
                                    options.admin_listen, options.health_listen})
    EXPECT_EQ(listen.rfind("127.0.0.1:", 0), 0u) << listen << " is open to other machines";
  // The keys that are commented out exist too, and limits stand at their defaults.
  const std::regex commented("\n# ([a-z_]+: \\S+)(?=\n)");
  const std::string sample = Deploy("serve.yaml");
  EXPECT_FALSE(Options("all", std::regex_replace(sample, commented, "\n$1")).tokens.empty());
  std::string limits;
  for (std::sregex_iterator at(sample.begin(), sample.end(), commented), end; at != end; ++at) {
    if (!(*at)[1].str().starts_with("tls_") && !(*at)[1].str().starts_with("tokens"))
      absl::StrAppend(&limits, (*at)[1].str(), "\n");
  }
  EXPECT_GT(std::count(limits.begin(), limits.end(), '\n'), 10);
  EXPECT_EQ(DumpConfig(Options("limits", limits)), DumpConfig(ServeOptions()));
}

TEST(Deploy, TheSystemdUnitStartsTheServerAndWaitsForItsGrace) {
  const std::string unit = Deploy("systemd/robostress-serve.service");
  std::smatch match;
  ASSERT_TRUE(
      std::regex_search(unit, match, std::regex("\nExecStart=(\\S+)/robostress-serve (.*)\n")));
  const std::vector<std::string> words = absl::StrSplit(match[2].str(), ' ');
  for (const std::string& word : words) {
    if (word.rfind("--", 0) == 0) {
      EXPECT_EQ(KnownFlags().count(word), 1u) << word;
    }
  }
  std::smatch stop;
  ASSERT_TRUE(std::regex_search(unit, stop, std::regex("\nTimeoutStopSec=(\\d+)\n")));
  EXPECT_GT(std::stod(stop[1]), 2 * Options("serve.yaml", Deploy("serve.yaml")).grace)
      << "the server may use `grace` for WebSockets and again for gRPC";
  EXPECT_THAT(unit, HasSubstr("\nStateDirectory=robostress\n"));
  EXPECT_THAT(unit, HasSubstr("\nExecReload=/bin/kill -HUP $MAINPID\n"));

  if (std::system("command -v systemd-analyze > /dev/null") != 0) GTEST_SKIP() << "no systemd";
  const auto folder = std::filesystem::path(::testing::TempDir()) / "unit";
  std::filesystem::create_directories(folder);
  const auto file = folder / "robostress-serve.service";
  // The binary is not installed here.
  const std::string runnable =
      std::regex_replace(unit, std::regex("ExecStart=\\S+"), "ExecStart=/bin/true");
  ASSERT_TRUE(WriteFileAtomically(file.string(), runnable).ok());
  const auto [output, code] = RunProgram("systemd-analyze", "verify --man=no " + file.string());
  EXPECT_EQ(code, 0);
  EXPECT_EQ(output.find("robostress-serve.service:"), std::string::npos) << output;
}

// DynamicUser= owns no file: what only root may read is handed over, or read as a group's member.
TEST(Deploy, TheUnitsUserCanReadEverySecretThatItsFlagsName) {
  const std::string unit = Deploy("systemd/robostress-serve.service");
  ASSERT_THAT(unit, HasSubstr("\nDynamicUser=yes\n"));
  const std::string folder = "systemd/robostress-serve.service.d/";
  for (const std::string& drop_in : {std::string(), Deploy(folder + "mtls.conf.sample"),
                                     Deploy(folder + "reload.conf.sample")}) {
    std::set<std::string> given;
    std::string command;
    for (const std::string& line : std::vector<std::string>(absl::StrSplit(unit + drop_in, '\n'))) {
      if (line == "LoadCredential=") given.clear();
      std::smatch match;
      if (std::regex_match(line, match, std::regex("LoadCredential=([^:]+):/etc/robostress/.*")))
        given.insert(match[1]);
      if (line.starts_with("ExecStart=")) command = line;
    }
    const std::regex secret(" --(tls-[a-z-]+|tokens) (\\S+)");
    int secrets = 0;
    for (std::sregex_iterator at(command.begin(), command.end(), secret), end; at != end; ++at) {
      const std::string file = (*at)[2];
      ++secrets;
      EXPECT_EQ(KnownFlags().count("--" + (*at)[1].str()), 1u) << (*at)[1];
      EXPECT_TRUE(given.empty() ? unit.size() < (unit + drop_in).size() &&
                                      drop_in.find("SupplementaryGroups=") != std::string::npos
                                : file.starts_with("%d/") && given.count(file.substr(3)) == 1)
          << file << " is not readable";
    }
    EXPECT_GE(secrets, 3) << command;
    EXPECT_EQ(given.count("tls.key") + (command.find("%d/") == std::string::npos), 1u);
  }
  // What is in the sample configuration is loopback and names none of them.
  EXPECT_TRUE(Options("serve.yaml", Deploy("serve.yaml")).tls_key.empty());
}

// The stages of the container file, by name: what each copies to a place on the PATH or runs.
std::map<std::string, std::string> Stages() {
  std::map<std::string, std::string> stages;
  const std::string file =
      std::regex_replace(Deploy("container/Containerfile"), std::regex("\\\\\n"), " ");
  std::string name;
  for (const std::string& line : std::vector<std::string>(absl::StrSplit(file, '\n'))) {
    std::smatch match;
    if (std::regex_match(line, match, std::regex("FROM \\S+ AS (\\w+)"))) name = match[1];
    if (!line.starts_with("#")) absl::StrAppend(&stages[name], line, "\n");
  }
  return stages;
}

// Programs that a manifest starts: the image's own, and what commands, probes and hooks name.
void ProgramsOf(const YAML::Node& node, std::set<std::string>& programs) {
  if (node.IsSequence()) {
    for (const YAML::Node& item : node) ProgramsOf(item, programs);
  }
  if (!node.IsMap()) return;
  for (const auto& pair : node) {
    if (pair.first.as<std::string>() == "command" && pair.second.IsSequence())
      programs.insert(pair.second[0].as<std::string>());
    ProgramsOf(pair.second, programs);
  }
}

TEST(Deploy, TheImagesHoldEveryProgramThatManifestsAndOperatorsRunInThem) {
  std::map<std::string, std::string> stages = Stages();
  ASSERT_EQ(stages.count("serve") + stages.count("grid"), 2u);
  // The server's pod: its entry point, its probes, and what its comments tell an operator to run.
  std::set<std::string> programs = {"robostress-serve"};
  const std::string manifest = Deploy("kubernetes/policy-server.yaml");
  for (const YAML::Node& document : YAML::LoadAll(manifest)) ProgramsOf(document, programs);
  const std::regex exec("#[^\n]*[ ](robostress-[a-z-]+)(?= (list|drain))");
  for (std::sregex_iterator at(manifest.begin(), manifest.end(), exec), end; at != end; ++at)
    programs.insert((*at)[1]);
  EXPECT_EQ(programs.count("robostress-sessions"), 1u) << "operators' port is the pod's own";
  for (const std::string& program : programs) {
    EXPECT_THAT(stages["serve"], HasSubstr("/build/release/bin/" + program + " ")) << program;
    EXPECT_TRUE(program == "robostress-serve" ||
                stages["serve"].find("/usr/lib/robostress/bin/" + program + " /usr/bin/") !=
                    std::string::npos)
        << program << " is not on the PATH";
  }
  // A checkpoint's prompts are tokenised by a program beside the server.
  EXPECT_THAT(stages["serve"], HasSubstr("/build/release/bin/robostress-tokenize "));

  // Sweeps: what the manifests that a launcher writes run, and what those programs start.
  const std::string launch = absl::StrCat(ROBOSTRESS_SOURCE_DIR, "/eval/launch/");
  std::set<std::string> swept;
  for (const auto& file : std::filesystem::directory_iterator(launch)) {
    const std::string text = *ReadFile(file.path().string());
    for (const char* pattern :
         {"command: \\[(robostress-[a-z-]+)", "FindProgram\\(\"([a-z-]+)\"\\)"}) {
      const std::regex program(pattern);
      for (std::sregex_iterator at(text.begin(), text.end(), program), end; at != end; ++at)
        swept.insert((*at)[1]);
    }
  }
  EXPECT_TRUE(swept.count("robostress-grid-job") && swept.count("serve"));
  // That image is built from every target and has all of them on its PATH.
  EXPECT_THAT(stages["grid"], HasSubstr("cmake --build --preset release && ln -s "
                                        "/src/build/release/bin/robostress* /usr/bin/ "));
  EXPECT_EQ(stages["build"].find("ROBOSTRESS_MUJOCO=OFF"), std::string::npos)
      << "robostress-worker needs MuJoCo";
}

TEST(Deploy, TheContainerFileNamesFlagsAndFilesThatExist) {
  const std::string file = Deploy("container/Containerfile");
  const std::regex flag("\"(--[a-z-]+)\"");
  for (std::sregex_iterator at(file.begin(), file.end(), flag), end; at != end; ++at)
    EXPECT_EQ(KnownFlags().count((*at)[1]), 1u) << (*at)[1];
  for (const char* used : {"deploy/packages.txt", "LICENSE", "server/models/weights"}) {
    EXPECT_THAT(file, HasSubstr(used));
    EXPECT_TRUE(std::filesystem::exists(absl::StrCat(ROBOSTRESS_SOURCE_DIR, "/", used)));
  }
  EXPECT_THAT(file, HasSubstr("\nUSER 65532:65532\n"));
  EXPECT_THAT(file, HasSubstr("\nSTOPSIGNAL SIGTERM\n"));
}

TEST(Deploy, AnInstalledServerFindsTheWeightsThatComeWithIt) {
  const std::string variable = "ROBOSTRESS_WEIGHTS_DIR=/usr/lib/robostress/weights\n";
  const std::string file = Deploy("container/Containerfile");
  EXPECT_THAT(file, HasSubstr(variable));
  EXPECT_THAT(file, HasSubstr("\nCOPY server/models/weights /usr/lib/robostress/weights\n"));
  EXPECT_THAT(Deploy("systemd/robostress-serve.service"), HasSubstr(variable));
}

class Kubernetes : public ::testing::Test {
 protected:
  void SetUp() override {
    for (const YAML::Node& document : YAML::LoadAll(Deploy("kubernetes/policy-server.yaml"))) {
      ASSERT_TRUE(document["apiVersion"] && document["metadata"]["name"]);
      objects_[document["kind"].as<std::string>()] = document;
    }
    ASSERT_EQ(objects_.size(), 4u);
    config_ = Options("ConfigMap", objects_["ConfigMap"]["data"]["serve.yaml"].as<std::string>());
    pod_ = objects_["StatefulSet"]["spec"]["template"];
    container_ = pod_["spec"]["containers"][0];
  }
  std::map<std::string, YAML::Node> objects_;
  ServeOptions config_;
  YAML::Node pod_, container_;
};

TEST_F(Kubernetes, EveryPortIsOneThatTheServerListensOn) {
  std::map<std::string, int> ports;
  for (const YAML::Node& port : container_["ports"])
    ports[port["name"].as<std::string>()] = port["containerPort"].as<int>();
  EXPECT_EQ(ports["grpc"], PortOf(config_.listen));
  EXPECT_EQ(ports["openpi"], PortOf(config_.websocket_listen));
  EXPECT_EQ(ports["http"], PortOf(config_.http_listen));
  EXPECT_EQ(ports["health"], PortOf(config_.health_listen));
  EXPECT_EQ(ports.size(), 4u) << "operators' port is not published";
  EXPECT_EQ(config_.admin_listen.rfind("127.0.0.1:", 0), 0u);
  for (const YAML::Node& port : objects_["Service"]["spec"]["ports"])
    EXPECT_EQ(ports.count(port["targetPort"].as<std::string>()), 1u);
  for (const char* probe : {"startupProbe", "readinessProbe", "livenessProbe"}) {
    const YAML::Node get = container_[probe]["httpGet"];
    EXPECT_EQ(get["port"].as<std::string>(), "health") << probe;
    EXPECT_EQ(get["scheme"].as<std::string>(), "HTTP") << "kubelet shows no certificate";
  }
  EXPECT_FALSE(config_.tls_client_ca.empty()) << "the sample is one with mTLS";
  for (const YAML::Node& port : objects_["Service"]["spec"]["ports"])
    EXPECT_NE(port["targetPort"].as<std::string>(), "health") << "for the node alone";
  EXPECT_EQ(container_["readinessProbe"]["httpGet"]["path"].as<std::string>(), "/readyz");
}

TEST_F(Kubernetes, SelectorsFindThePodAndPathsAreMounted) {
  const auto label = [](const YAML::Node& labels) {
    return labels["app.kubernetes.io/name"].as<std::string>();
  };
  const std::string name = label(pod_["metadata"]["labels"]);
  EXPECT_EQ(label(objects_["StatefulSet"]["spec"]["selector"]["matchLabels"]), name);
  EXPECT_EQ(label(objects_["Service"]["spec"]["selector"]), name);
  EXPECT_EQ(label(objects_["NetworkPolicy"]["spec"]["podSelector"]["matchLabels"]), name);
  EXPECT_EQ(objects_["StatefulSet"]["spec"]["serviceName"].as<std::string>(),
            objects_["Service"]["metadata"]["name"].as<std::string>());

  std::set<std::string> volumes;
  for (const YAML::Node& volume : pod_["spec"]["volumes"])
    volumes.insert(volume["name"].as<std::string>());
  for (const YAML::Node& claim : objects_["StatefulSet"]["spec"]["volumeClaimTemplates"])
    volumes.insert(claim["metadata"]["name"].as<std::string>());
  std::vector<std::string> mounts;
  for (const YAML::Node& mount : container_["volumeMounts"]) {
    EXPECT_EQ(volumes.erase(mount["name"].as<std::string>()), 1u) << mount["name"];
    mounts.push_back(mount["mountPath"].as<std::string>());
  }
  EXPECT_TRUE(volumes.empty()) << "a volume is not mounted";
  for (const std::string& path :
       {config_.state_dir, config_.tokens, config_.tls_certificate, config_.tls_key,
        config_.tls_client_ca, container_["args"][1].as<std::string>()}) {
    EXPECT_TRUE(std::any_of(mounts.begin(), mounts.end(),
                            [&](const std::string& mount) { return path.rfind(mount, 0) == 0; }))
        << path << " is on no volume";
  }
}

TEST_F(Kubernetes, ThePodMayDoNothingButServeAndIsGivenTimeToStop) {
  EXPECT_GT(pod_["spec"]["terminationGracePeriodSeconds"].as<double>(), 2 * config_.grace);
  EXPECT_TRUE(pod_["spec"]["securityContext"]["runAsNonRoot"].as<bool>());
  EXPECT_FALSE(pod_["spec"]["automountServiceAccountToken"].as<bool>());
  const YAML::Node security = container_["securityContext"];
  EXPECT_FALSE(security["allowPrivilegeEscalation"].as<bool>());
  EXPECT_TRUE(security["readOnlyRootFilesystem"].as<bool>());
  EXPECT_EQ(security["capabilities"]["drop"][0].as<std::string>(), "ALL");
  EXPECT_EQ(objects_["StatefulSet"]["spec"]["replicas"].as<int>(), 1) << "sessions have one disk";
  EXPECT_FALSE(config_.tokens.empty()) << "the ports are open to other pods";
}

}  // namespace
}  // namespace robostress
