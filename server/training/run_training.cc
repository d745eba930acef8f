#include <chrono>
#include <cstdio>
#include <ctime>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "server/training/trainer.h"

namespace robostress {
namespace {

using Seconds = std::chrono::duration<double>;

struct OutputFiles {
  explicit OutputFiles(const std::string& out)
      : config(out + "/config.yaml"),
        log(out + "/train.jsonl"),
        checkpoint(out + "/checkpoint.safetensors"),
        weights(out + "/nano.safetensors"),
        done(out + "/DONE") {}
  std::string config, log, checkpoint, weights, done;
};

// The model that training starts from, with words and normalisation of the data (or of `weights`
// where given).
absl::StatusOr<NanoModel> StartModel(const TrainOptions& options, const std::string& weights,
                                     const Demonstrations& demonstrations) {
  NanoModel model;
  if (weights.empty()) {
    model = RandomNanoModel(options.network, options.seed);
    demonstrations.MeasureNormalisation(model);
  } else {
    RS_ASSIGN_OR_RETURN(model, LoadNanoModel(weights));
  }
  RS_ASSIGN_OR_RETURN(model.vocabulary, demonstrations.CollectWords(model.vocabulary));
  return model;
}

absl::Status Publish(const Trainer& trainer, const OutputFiles& files) {
  RS_RETURN_IF_ERROR(SaveNanoModel(trainer.Published(), files.weights));
  return trainer.SaveCheckpoint(files.checkpoint);
}

absl::Status LogEvaluation(const Trainer& trainer, const OutputFiles& files) {
  RS_ASSIGN_OR_RETURN(const Evaluation result, trainer.Evaluate());
  const nlohmann::json line = {{"step", trainer.step()},
                               {"validation_flow", result.losses.flow},
                               {"validation_aux", result.losses.aux},
                               {"action_error", result.action_error},
                               {"gripper_agreement", result.gripper_agreement},
                               {"target_error_mm", result.target_error_mm},
                               {"destination_error_mm", result.destination_error_mm}};
  absl::PrintF(
      "step %d  held out: flow %.4f  action error %.4f  gripper %.1f %%  target %.1f mm  "
      "destination %.1f mm\n",
      trainer.step(), result.losses.flow, result.action_error, 100 * result.gripper_agreement,
      result.target_error_mm, result.destination_error_mm);
  return AppendLine(files.log, line.dump());
}

}  // namespace

absl::Status RunTraining(const TrainOptions& given, bool resume) {
  TrainOptions options = given;
  RS_RETURN_IF_ERROR(ValidateTrainOptions(options));
  const OutputFiles files(options.out);
  const bool started = std::filesystem::exists(files.checkpoint);
  if (started && !resume) {
    return absl::AlreadyExistsError(
        absl::StrCat(options.out,
                     " holds a training run already; add --resume to go on, or "
                     "choose another --out"));
  }
  const std::string weights = started ? files.weights : options.init;
  if (!weights.empty()) {
    RS_ASSIGN_OR_RETURN(const NanoModel model, LoadNanoModel(weights));
    options.network = model.config;
  }
  RS_ASSIGN_OR_RETURN(
      const Demonstrations demonstrations,
      Demonstrations::Open(options.data, options.network, options.validation_share));
  RS_ASSIGN_OR_RETURN(NanoModel model, StartModel(options, weights, demonstrations));
  RS_RETURN_IF_ERROR(MakeDirectories(options.out));
  std::error_code absent;  // a run that goes on with more steps is not finished any more
  std::filesystem::remove(files.done, absent);
  Trainer trainer(options, std::move(model), demonstrations);
  if (started) RS_RETURN_IF_ERROR(trainer.LoadCheckpoint(files.checkpoint));
  RS_RETURN_IF_ERROR(WriteFileAtomically(files.config, DumpConfig(options)));
  absl::PrintF("%d training frames, %d held out, %d episodes; %d parameters; step %d of %d\n",
               demonstrations.training().size(), demonstrations.validation().size(),
               demonstrations.episodes(), trainer.parameter_count(), trainer.step(), options.steps);

  const auto start = std::chrono::steady_clock::now();
  auto window_start = start;
  std::clock_t window_cpu = std::clock();  // of all threads
  TrainLosses window;
  int64_t window_steps = 0;
  const int64_t first_step = trainer.step();
  while (trainer.step() < options.steps) {
    RS_ASSIGN_OR_RETURN(const TrainLosses losses, trainer.Step());
    window.flow += losses.flow;
    window.aux += losses.aux;
    ++window_steps;
    const int64_t step = trainer.step();
    const bool last = step == options.steps;
    if (step % options.log_every == 0 || last) {
      const auto now = std::chrono::steady_clock::now();
      const double seconds = Seconds(now - window_start).count(),
                   elapsed = Seconds(now - start).count();
      const double rate = static_cast<double>(window_steps * options.batch) / seconds;
      const double cpu_ms = 1e3 * static_cast<double>(std::clock() - window_cpu) / CLOCKS_PER_SEC /
                            static_cast<double>(window_steps * options.batch);
      const double remaining = elapsed / static_cast<double>(step - first_step) *
                               static_cast<double>(options.steps - step);
      const nlohmann::json line = {{"step", step},
                                   {"flow", window.flow / window_steps},
                                   {"aux", window.aux / window_steps},
                                   {"lr", trainer.learning_rate()},
                                   {"gradient_norm", trainer.gradient_norm()},
                                   {"samples_per_s", rate},
                                   {"cpu_ms_per_sample", cpu_ms},
                                   {"elapsed_s", elapsed}};
      RS_RETURN_IF_ERROR(AppendLine(files.log, line.dump()));
      absl::PrintF(
          "step %d/%d  flow %.4f  aux %.4f  %.0f samples/s (%.1f CPU ms each)  %.0f s left\n", step,
          options.steps, window.flow / window_steps, window.aux / window_steps, rate, cpu_ms,
          remaining);
      std::fflush(stdout);
      window = {};
      window_steps = 0;
      window_start = std::chrono::steady_clock::now();
      window_cpu = std::clock();
    }
    if (step % options.checkpoint_every == 0 || last) RS_RETURN_IF_ERROR(Publish(trainer, files));
    if ((step % options.evaluate_every == 0 || last) && !demonstrations.validation().empty()) {
      RS_RETURN_IF_ERROR(LogEvaluation(trainer, files));
      window_start = std::chrono::steady_clock::now();
      window_cpu = std::clock();
    }
  }
  absl::PrintF("weights: %s\n", files.weights);
  return WriteFileAtomically(files.done, "");
}

}  // namespace robostress
