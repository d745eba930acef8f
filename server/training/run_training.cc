#include <chrono>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <map>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "server/training/libero_shards.h"
#include "server/training/success_evaluation.h"
#include "server/training/trainer.h"

namespace robostress {
namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

struct OutputFiles {
  explicit OutputFiles(const std::string& out)
      : config(out + "/config.yaml"),
        log(out + "/train.jsonl"),
        checkpoint(out + "/checkpoint.safetensors"),
        weights(out + "/nano.safetensors"),
        evaluation(out + "/evaluation"),
        converted(out + "/data"),
        done(out + "/DONE") {}
  std::string config, log, checkpoint, weights, evaluation, converted, done;
};

// Takes over what `model` shares with the weights in `file`: words, tensors of equal name and
// shape, and normalisation where state, actions and auxiliary targets have the same meaning.
// Another robot's stays that of its own demonstrations.
absl::Status Graft(const std::string& file, NanoModel& model) {
  RS_ASSIGN_OR_RETURN(const NanoModel donor, LoadNanoModel(file));
  const NanoConfig &have = donor.config, &want = model.config;
  if (have.vocabulary_rows != want.vocabulary_rows) {
    return absl::InvalidArgumentError(absl::StrCat(
        file, ": vocabulary_rows is ", have.vocabulary_rows, ", the network's is ",
        want.vocabulary_rows, "; graft weights with as many, or set network.vocabulary_rows"));
  }
  const bool same_robot = have.state_dim == want.state_dim && have.action_dim == want.action_dim &&
                          have.aux_dim == want.aux_dim &&
                          have.displacement_channels == want.displacement_channels;
  std::map<std::string, size_t> place;
  const std::vector<NanoTensorInfo> donated = NanoTensorTable(have);
  for (size_t i = 0; i < donated.size(); ++i) place[donated[i].name] = i;
  const std::vector<NanoTensorInfo> table = NanoTensorTable(want);
  size_t taken = 0;
  for (size_t i = 0; i < table.size(); ++i) {
    const auto found = place.find(table[i].name);
    if (found == place.end() || donated[found->second].shape != table[i].shape) continue;
    model.tensors[i] = donor.tensors[found->second];
    ++taken;
  }
  model.vocabulary = donor.vocabulary;
  if (same_robot) {
    model.state = donor.state;
    model.actions = donor.actions;
    model.aux = donor.aux;
  }
  absl::PrintF("%d of %d tensors are those of %s\n", taken, table.size(), file);
  return absl::OkStatus();
}

// The model that training starts from, with words and normalisation of the data (or of `weights`
// where given).
absl::StatusOr<NanoModel> StartModel(const TrainOptions& options, const std::string& weights,
                                     const Demonstrations& demonstrations) {
  NanoModel model;
  if (weights.empty()) {
    model = RandomNanoModel(options.network, options.seed);
    demonstrations.MeasureNormalisation(model);
    if (!options.graft.empty()) RS_RETURN_IF_ERROR(Graft(options.graft, model));
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

absl::Status LogSuccess(const Trainer& trainer, const TrainOptions& options,
                        const OutputFiles& files) {
  RS_RETURN_IF_ERROR(Publish(trainer, files));
  std::fflush(stdout);
  RS_ASSIGN_OR_RETURN(
      const SuccessCount count,
      MeasureSuccess(options.evaluate_command, files.weights,
                     absl::StrCat(files.evaluation, "/step_", trainer.step()), trainer.step()));
  absl::PrintF("step %d  success %d/%d\n", trainer.step(), count.successes, count.episodes);
  const nlohmann::json line = {
      {"step", trainer.step()}, {"successes", count.successes}, {"episodes", count.episodes}};
  return AppendLine(files.log, line.dump());
}

// Held-out errors, and success where a command measures it.
absl::Status EvaluateNow(const Trainer& trainer, const TrainOptions& options,
                         const OutputFiles& files) {
  if (trainer.has_held_out()) RS_RETURN_IF_ERROR(LogEvaluation(trainer, files));
  return options.evaluate_command.empty() ? absl::OkStatus() : LogSuccess(trainer, options, files);
}

// What happened since the last line of the log.
struct Window {
  explicit Window(const Trainer& trainer) : data_start(trainer.data_seconds()) {}
  void Add(const TrainLosses& losses) {
    sum.flow += losses.flow;
    sum.aux += losses.aux;
    sum.clean_flow += losses.clean_flow;
    ++steps;
  }
  TrainLosses sum;
  int64_t steps = 0;
  Clock::time_point start = Clock::now();
  std::clock_t cpu_start = std::clock();  // of all threads
  double data_start;
};

absl::Status LogWindow(const Window& window, const Trainer& trainer, const TrainOptions& options,
                       const OutputFiles& files, double elapsed, double remaining) {
  const double seconds = Seconds(Clock::now() - window.start).count();
  const double steps = static_cast<double>(window.steps), samples = steps * options.batch;
  const double cpu_ms =
      1e3 * static_cast<double>(std::clock() - window.cpu_start) / CLOCKS_PER_SEC / samples;
  // Of the threads' time; everything else is computing.
  const double data_share =
      (trainer.data_seconds() - window.data_start) / (seconds * options.threads);
  nlohmann::json line = {{"step", trainer.step()},
                         {"flow", window.sum.flow / steps},
                         {"aux", window.sum.aux / steps},
                         {"lr", trainer.learning_rate()},
                         {"gradient_norm", trainer.gradient_norm()},
                         {"samples_per_s", samples / seconds},
                         {"cpu_ms_per_sample", cpu_ms},
                         {"data_share", data_share},
                         {"elapsed_s", elapsed}};
  std::string robust;
  if (options.objective == Objective::kRobust) {
    line["clean_flow"] = window.sum.clean_flow / steps;
    robust = absl::StrFormat(" (clean %.4f)", window.sum.clean_flow / steps);
  }
  absl::PrintF(
      "step %d/%d  flow %.4f%s  aux %.4f  %.0f samples/s (%.1f CPU ms each, data %.1f %%)  %.0f s "
      "left\n",
      trainer.step(), options.steps, window.sum.flow / steps, robust, window.sum.aux / steps,
      samples / seconds, cpu_ms, 100 * data_share, remaining);
  std::fflush(stdout);
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
      const std::vector<std::string> shards,
      PrepareShards(options.data, options.network, options.hdf5_stride, files.converted));
  RS_ASSIGN_OR_RETURN(const Demonstrations demonstrations,
                      Demonstrations::Open(shards, options.network, options.validation_share));
  if (!demonstrations.without_aux().empty() && options.aux_weight > 0) {
    return absl::InvalidArgumentError(
        absl::StrCat(demonstrations.without_aux(), ": no auxiliary targets, and aux_weight is ",
                     options.aux_weight, "; train with --set aux_weight=0"));
  }
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

  if (trainer.step() == 0 && !options.init.empty())
    RS_RETURN_IF_ERROR(EvaluateNow(trainer, options, files));
  Window window(trainer);
  const auto start = Clock::now();
  const int64_t first_step = trainer.step();
  while (trainer.step() < options.steps) {
    RS_ASSIGN_OR_RETURN(const TrainLosses losses, trainer.Step());
    window.Add(losses);
    const int64_t step = trainer.step();
    const bool last = step == options.steps;
    if (step % options.log_every == 0 || last) {
      const double elapsed = Seconds(Clock::now() - start).count();
      const double remaining = elapsed / static_cast<double>(step - first_step) *
                               static_cast<double>(options.steps - step);
      RS_RETURN_IF_ERROR(LogWindow(window, trainer, options, files, elapsed, remaining));
      window = Window(trainer);
    }
    if (step % options.checkpoint_every == 0 || last) RS_RETURN_IF_ERROR(Publish(trainer, files));
    if (step % options.evaluate_every == 0 || last) {
      RS_RETURN_IF_ERROR(EvaluateNow(trainer, options, files));
      window = Window(trainer);
    }
  }
  absl::PrintF("weights: %s\ncurves:  robostress report --training %s\n", files.weights,
               options.out);
  return WriteFileAtomically(files.done, "");
}

}  // namespace robostress
