#include "server/policies/openpi/checkpoint_commands.h"

#include <chrono>
#include <cstdio>
#include <fstream>
#include <memory>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "nlohmann/json.hpp"
#include "server/policies/openpi/checkpoint_generator.h"
#include "server/policies/openpi/checkpoint_load.h"
#include "server/policies/openpi/policy_check.h"

namespace robostress::openpi {
namespace {

constexpr int kFailed = 1, kBadInput = 2;

int Refuse(const absl::Status& status) {
  std::fprintf(stderr, "robostress-policy: %s\n", std::string(status.message()).c_str());
  return kBadInput;
}

// A line of /proc/self/status [bytes], 0 where the system has none.
int64_t MemoryOf(const std::string& field) {
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (!absl::StartsWith(line, field + ":")) continue;
    const std::vector<std::string> words =
        absl::StrSplit(line.substr(field.size() + 1), ' ', absl::SkipWhitespace());
    int64_t kib = 0;
    if (!words.empty() && absl::SimpleAtoi(words[0], &kib)) return kib * 1024;
  }
  return 0;
}

// From here on the peak of resident memory counts anew.
void ResetPeak() { std::ofstream("/proc/self/clear_refs") << "5"; }

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

struct CheckArguments {
  CheckOptions options;
  bool json = false;
};

int RunCheck(const CheckArguments& arguments) {
  const auto report = CheckPolicy(arguments.options);
  if (!report.ok()) {
    if (arguments.json) {
      const nlohmann::ordered_json error = {{"passed", false},
                                            {"error", std::string(report.status().message())}};
      std::printf(
          "%s\n",
          error.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
    }
    return Refuse(report.status());
  }
  const std::string text =
      arguments.json ? ReportJson(arguments.options, *report) : ReportText(*report);
  std::fputs(text.c_str(), stdout);
  return report->num_failed() == 0 ? 0 : kFailed;
}

struct LoadArguments {
  std::string path, precision = "bf16";
  CheckpointOptions checkpoint;
  LoadOptions load;
};

int RunLoad(LoadArguments arguments) {
  const auto precision = ParsePrecision(arguments.precision);
  if (!precision.ok()) return Refuse(precision.status());
  arguments.load.precision = *precision;
  const int64_t before = MemoryOf("VmRSS");
  ResetPeak();
  const auto start = std::chrono::steady_clock::now();
  const auto checkpoint = OpenCheckpoint(arguments.path, arguments.checkpoint);
  if (!checkpoint.ok()) return Refuse(checkpoint.status());
  const double open_s = SecondsSince(start);
  const auto model = LoadCheckpoint(*checkpoint, arguments.load);
  if (!model.ok()) return Refuse(model.status());
  const nlohmann::ordered_json report = {{"checkpoint", checkpoint->path},
                                         {"network", checkpoint->config.name()},
                                         {"layout", LayoutName(checkpoint->layout)},
                                         {"stored", checkpoint->stored_precision()},
                                         {"precision", arguments.precision},
                                         {"file_bytes", checkpoint->file_bytes()},
                                         {"tensor_bytes", checkpoint->tensor_bytes()},
                                         {"open_s", open_s},
                                         {"load_s", SecondsSince(start) - open_s},
                                         {"resident_before_bytes", before},
                                         {"resident_peak_bytes", MemoryOf("VmHWM")},
                                         {"resident_after_bytes", MemoryOf("VmRSS")},
                                         {"notes", checkpoint->notes}};
  std::printf("%s\n",
              report.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace).c_str());
  return 0;
}

constexpr char kCheckExamples[] = R"(Examples:
  robostress policy check --weights pi0.weights.safetensors --io pi0.io.safetensors
  robostress policy check --weights pi0.weights.safetensors --io pi0.io.safetensors --lora pi0.lora.safetensors
  robostress policy check --weights pi0.weights_bf16.safetensors --io pi0.io_bf16w.safetensors --json

With --lora, the expected values of the adapter's file are checked instead of those of --io.
Exit code 0: all quantities within tolerance, 1: one is not or is unknown, 2: bad usage or files.)";

constexpr char kGenerateExamples[] = R"(Examples:
  robostress policy generate --network pi0 --size full --out pi0_random          # 7.0 GB
  robostress policy generate --network pi0.5 --size tiny --layout lerobot --shards 3 --out tiny

Exit code 0: written, 2: bad usage, or nothing was written.)";

constexpr char kLoadExamples[] = R"(Examples:
  robostress policy load --checkpoint pi0_base
  robostress policy load --checkpoint pi0/model.safetensors.index.json --precision as_stored --horizon 50

Exit code 0: loaded, 2: bad usage or files.)";

}  // namespace

PolicyCommand AddCheckCommand(cli::App& policy) {
  const auto arguments = std::make_shared<CheckArguments>();
  cli::App* app = policy.add_subcommand(
      "check", "Compare every intermediate of a network with expected values from a file");
  app->footer(kCheckExamples);
  CheckOptions& options = arguments->options;
  app->add_option("--weights", options.weights, "safetensors file with openpi's tensor names")
      ->required();
  app->add_option("--io", options.io, "file with inputs/* and expected/*")->required();
  app->add_option("--inputs", options.inputs,
                  "file with inputs/* where --io has none (default: CASE.io.safetensors beside "
                  "CASE.io_*.safetensors)");
  app->add_option("--lora", options.lora, "file with lora/* and the expected values with it");
  app->add_flag("--json", arguments->json, "print one JSON object");
  return {app, [arguments] { return RunCheck(*arguments); }};
}

PolicyCommand AddGenerateCommand(cli::App& policy) {
  struct Arguments {
    std::string network, size = "tiny", precision = "bf16", layout = "openpi";
    GeneratorOptions options;
  };
  const auto arguments = std::make_shared<Arguments>();
  cli::App* app = policy.add_subcommand("generate", "Write a checkpoint of random weights");
  app->footer(kGenerateExamples);
  app->add_option("--network", arguments->network, "pi0 or pi0.5")
      ->required()
      ->check(cli::IsMember({"pi0", "pi0.5"}));
  app->add_option("--size", arguments->size, "full (3.2 G parameters) or tiny")
      ->check(cli::IsMember({"full", "tiny"}))
      ->capture_default_str();
  app->add_option("--precision", arguments->precision, "of the stored weights: bf16 or float32")
      ->check(cli::IsMember({"bf16", "float32"}))
      ->capture_default_str();
  app->add_option("--layout", arguments->layout,
                  "names and side files: openpi, lerobot, lerobot_old")
      ->check(cli::IsMember({"openpi", "lerobot", "lerobot_old"}))
      ->capture_default_str();
  app->add_option("--shards", arguments->options.shards, "files that share the weights")
      ->capture_default_str();
  app->add_option("--seed", arguments->options.seed, "of the values")->capture_default_str();
  app->add_option("--out", arguments->options.out, "folder to create")->required();
  return {app, [arguments] {
            GeneratorOptions options = arguments->options;
            options.pi05 = arguments->network == "pi0.5";
            options.full = arguments->size == "full";
            options.dtype = arguments->precision == "float32" ? DType::kF32 : DType::kBF16;
            for (const auto layout : {CheckpointLayout::kOpenpi, CheckpointLayout::kLerobot,
                                      CheckpointLayout::kLerobotOld}) {
              if (arguments->layout == LayoutName(layout)) options.layout = layout;
            }
            const absl::Status status = GenerateCheckpoint(options);
            return status.ok() ? 0 : Refuse(status);
          }};
}

PolicyCommand AddLoadCommand(cli::App& policy) {
  const auto arguments = std::make_shared<LoadArguments>();
  cli::App* app =
      policy.add_subcommand("load", "Load a checkpoint and print how long and how much it takes");
  app->footer(kLoadExamples);
  app->add_option("--checkpoint", arguments->path, "folder, .safetensors file or index")
      ->required();
  app->add_option("--precision", arguments->precision, "as_stored, bf16 or float32")
      ->capture_default_str();
  app->add_flag("--float32-vision", arguments->load.float32_vision,
                "with bf16: image encoder and projector in float32, as LeRobot does");
  app->add_option("--horizon", arguments->checkpoint.horizon,
                  "actions per chunk, where no file says it");
  return {app, [arguments] { return RunLoad(*arguments); }};
}

}  // namespace robostress::openpi
