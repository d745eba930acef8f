#include <malloc.h>

#include <string>
#include <vector>

#include "common/config.h"
#include "common/run_main.h"
#include "server/training/trainer.h"

namespace {

constexpr char kExamples[] = R"(Examples:
  robostress-train --data demos --out runs/nano --steps 20000
  robostress-train --data demos --data dagger1 --init runs/nano/nano.safetensors --out runs/nano2 --steps 5000
  robostress-train --recipe server/training/nano.yaml --data demos --out runs/nano
  robostress-train --data demos --out runs/nano --steps 20000 --resume
  robostress-train ... --evaluate-every 500 --evaluate "robostress sweep --policies {weights}
      --suites tabletop_goal --scenarios clean --methods base --episodes 2 --first-state 40 --out {out} --no-report"
Any other field of the recipe: --set network.layers=3 --set lr=0.0005)";

absl::Status Train(const std::string& recipe, const std::vector<std::string>& overrides,
                   const std::vector<std::string>& data, bool resume) {
  robostress::TrainOptions options;
  if (!recipe.empty()) {
    auto loaded = robostress::LoadConfig<robostress::TrainOptions>(recipe);
    if (!loaded.ok()) return loaded.status();
    options = *std::move(loaded);
  }
  if (absl::Status status = robostress::ApplyOverrides(overrides, options); !status.ok())
    return status;
  if (!data.empty()) options.data = data;
  return robostress::RunTraining(options, resume);
}

}  // namespace

int main(int argc, char** argv) {
  // Activations are megabytes and live for milliseconds: keep them in the heap instead of mapping
  // fresh pages.
  mallopt(M_MMAP_THRESHOLD, 1 << 30);
  mallopt(M_TRIM_THRESHOLD, 2000 << 20);

  robostress::cli::App app{
      "Trains the embedded policy nano from demonstrations that robostress-record has written.",
      "robostress train"};
  app.footer(kExamples);
  std::string recipe;
  std::vector<std::string> data, overrides;
  bool resume = false;
  app.add_option("--recipe", recipe,
                 "YAML file with training options; the flags below override it");
  app.add_option(
      "--data", data,
      "directory of shards or an .hdf5 file in LIBERO's form, may be given more than once");
  app.add_option("--set", overrides, "field=value, may be given more than once");
  app.add_flag("--resume", resume, "go on from the checkpoint in --out");
  // Flags that are short for --set.
  const std::vector<std::pair<std::string, std::string>> fields = {
      {"out", "output directory"},     {"init", "weights to go on from"},
      {"steps", "optimizer steps"},    {"batch", "frames per step"},
      {"lr", "peak learning rate"},    {"seed", "of everything random"},
      {"threads", "training threads"}, {"objective", "bc, or robust: PGD on the action chunk"},
  };
  std::vector<std::string> values(fields.size());
  for (size_t i = 0; i < fields.size(); ++i)
    app.add_option("--" + fields[i].first, values[i], fields[i].second);
  std::string evaluate, evaluate_every;
  app.add_option("--evaluate", evaluate,
                 "command that measures success; {weights}, {out}, {step} are replaced");
  app.add_option("--evaluate-every", evaluate_every, "steps between evaluations");
  return robostress::RunMain(app, argc, argv, [&] {
    for (size_t i = 0; i < fields.size(); ++i) {
      if (!values[i].empty()) overrides.push_back(fields[i].first + "=" + values[i]);
    }
    if (!evaluate.empty()) overrides.push_back("evaluate_command=" + evaluate);
    if (!evaluate_every.empty()) overrides.push_back("evaluate_every=" + evaluate_every);
    return Train(recipe, overrides, data, resume);
  });
}
