#include "server/training/demonstrations.h"

#include <sys/mman.h>
#include <torch/types.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr float kStdEpsilon = 1e-6f;
// Smallest deviations: proprioception in m and rad, actions in command units, auxiliary targets in
// m.
constexpr double kStateFloor = 1e-3, kActionFloor = 0.02, kAuxFloor = 1e-2;

absl::StatusOr<std::vector<std::string>> ListShards(const std::vector<std::string>& directories) {
  std::vector<std::string> paths;
  for (const std::string& directory : directories) {
    std::error_code error;
    std::vector<std::string> found;
    fs::recursive_directory_iterator it(directory, error), end;
    while (!error && it != end) {
      if (it->path().extension() == ".safetensors" && it->is_regular_file(error))
        found.push_back(it->path().string());
      it.increment(error);
    }
    if (error) {
      return absl::NotFoundError(
          absl::StrCat("data directory '", directory, "' cannot be read: ", error.message()));
    }
    if (found.empty()) {
      return absl::NotFoundError(
          absl::StrCat("data directory '", directory,
                       "' holds no *.safetensors; write some with robostress-record"));
    }
    std::sort(found.begin(), found.end());
    paths.insert(paths.end(), found.begin(), found.end());
  }
  return paths;
}

// Writes one frame, shifted by (dx, dy) with the border repeated, as gain * value / 127.5 - 1 +
// offset per channel.
void ConvertImage(const uint8_t* source, int size, int dx, int dy, const float* gain,
                  const float* offset, float* target) {
  for (int row = 0; row < size; ++row) {
    const uint8_t* line = source + size_t{3} * size * std::clamp(row + dy, 0, size - 1);
    for (int col = 0; col < size; ++col, target += 3) {
      const uint8_t* pixel = line + size_t{3} * std::clamp(col + dx, 0, size - 1);
      for (int channel = 0; channel < 3; ++channel)
        target[channel] = pixel[channel] * gain[channel] + offset[channel];
    }
  }
}

// Mean and deviation of `dim` interleaved columns over what `visit` passes to its argument.
struct Moments {
  explicit Moments(int dim) : sum(dim), squares(dim) {}
  void Add(const float* row) {
    for (size_t i = 0; i < sum.size(); ++i) {
      sum[i] += row[i];
      squares[i] += double{row[i]} * row[i];
    }
    ++count;
  }
  ZScore Finish(double floor) const {
    ZScore z;
    for (size_t i = 0; i < sum.size(); ++i) {
      const double mean = sum[i] / std::max<double>(1, count);
      const double variance = squares[i] / std::max<double>(1, count) - mean * mean;
      z.mean.push_back(static_cast<float>(mean));
      z.std.push_back(static_cast<float>(std::max(floor, std::sqrt(std::max(0.0, variance)))));
    }
    return z;
  }
  std::vector<double> sum, squares;
  double count = 0;
};

}  // namespace

absl::StatusOr<Demonstrations> Demonstrations::Open(const std::vector<std::string>& directories,
                                                    const NanoConfig& config,
                                                    double validation_share) {
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> paths, ListShards(directories));
  Demonstrations demonstrations(config);
  for (const std::string& path : paths)
    RS_RETURN_IF_ERROR(demonstrations.AddShard(path, validation_share));
  if (demonstrations.training_.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("no training frames in ", absl::StrJoin(directories, ", ")));
  }
  return demonstrations;
}

absl::Status Demonstrations::AddShard(const std::string& path, double validation_share) {
  RS_ASSIGN_OR_RETURN(SafetensorsFile file, SafetensorsFile::Open(path));
  const auto instruction = file.metadata().find("instruction");
  if (instruction == file.metadata().end() || SplitWords(instruction->second).empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(path,
                     ": metadata 'instruction' is missing or empty: not a shard of "
                     "robostress-record"));
  }
  RS_ASSIGN_OR_RETURN(const TensorView episode, file.Get("episode"));
  if (episode.dtype != DType::kI64 || episode.shape.size() != 1) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": episode must be I64 [frames]"));
  }
  const int64_t frames = episode.shape[0], size = config_.image_size;
  const auto take = [&](const char* name, DType dtype,
                        const std::vector<int64_t>& shape) -> absl::StatusOr<const uint8_t*> {
    RS_ASSIGN_OR_RETURN(const TensorView view, file.Get(name));
    if (view.dtype != dtype || view.shape != shape) {
      return absl::InvalidArgumentError(absl::StrCat(
          path, ": ", name, " is ", DTypeName(view.dtype), " [", absl::StrJoin(view.shape, ","),
          "], must be ", DTypeName(dtype), " [", absl::StrJoin(shape, ","), "]"));
    }
    return view.bytes.data();
  };
  const int64_t views = static_cast<int64_t>(config_.cameras.size());
  const auto floats = [&](const char* name,
                          const std::vector<int64_t>& shape) -> absl::StatusOr<const float*> {
    RS_ASSIGN_OR_RETURN(const uint8_t* bytes, take(name, DType::kF32, shape));
    return reinterpret_cast<const float*>(bytes);
  };
  RS_ASSIGN_OR_RETURN(const uint8_t* images,
                      take("images", DType::kU8, {frames, views, size, size, 3}));
  RS_ASSIGN_OR_RETURN(const float* state, floats("state", {frames, config_.state_dim}));
  RS_ASSIGN_OR_RETURN(const float* actions,
                      floats("actions", {frames, config_.horizon, config_.action_dim}));
  const float* aux = nullptr;
  if (file.tensors().count("aux") > 0) {
    RS_ASSIGN_OR_RETURN(aux, floats("aux", {frames, config_.aux_dim}));
  } else {
    const auto source = file.metadata().find("source");  // of a file in LIBERO's form
    without_aux_ = source == file.metadata().end() ? path : source->second;
  }
  const auto check = [&](const char* name, const float* values, int64_t count) -> absl::Status {
    for (int64_t i = 0; i < count; ++i) {
      if (!std::isfinite(values[i])) {
        return absl::InvalidArgumentError(
            absl::StrCat(path, ": ", name, " holds ", values[i], " at ", i));
      }
    }
    return absl::OkStatus();
  };
  RS_RETURN_IF_ERROR(check("state", state, frames * config_.state_dim));
  RS_RETURN_IF_ERROR(check("actions", actions, frames * config_.horizon * config_.action_dim));
  if (aux != nullptr) RS_RETURN_IF_ERROR(check("aux", aux, frames * config_.aux_dim));

  const int64_t* ids = reinterpret_cast<const int64_t*>(episode.bytes.data());
  bool held_out = false;
  for (int64_t i = 0; i < frames; ++i) {
    if (i == 0 || ids[i] != ids[i - 1]) {
      RandomStream draw(StreamKey("validation").With(instruction->second).With(ids[i]));
      held_out = draw.Uniform() < validation_share;
      ++episodes_;
    }
    (held_out ? validation_ : training_).push_back(frames_ + i);
  }
  const int64_t first = frames_;
  frames_ += frames;
  std::string words = instruction->second;
  shards_.push_back(
      {std::move(file), std::move(words), first, frames, images, state, actions, aux});
  return absl::OkStatus();
}

const Demonstrations::Shard& Demonstrations::ShardOf(int64_t frame) const {
  const auto after =
      std::upper_bound(shards_.begin(), shards_.end(), frame,
                       [](int64_t value, const Shard& shard) { return value < shard.first; });
  return *(after - 1);
}

std::vector<float> Demonstrations::Action(const Shard& shard, int64_t frame, int step) const {
  const float* values = shard.actions + (frame * config_.horizon + step) * config_.action_dim;
  std::vector<float> action(values, values + config_.action_dim);
  for (int j = 0; j < config_.displacement_channels; ++j)
    action[j] -= shard.state[frame * config_.state_dim + j];
  return action;
}

absl::StatusOr<Vocabulary> Demonstrations::CollectWords(Vocabulary start) const {
  for (const Shard& shard : shards_) {
    start.Add(shard.instruction);
    RS_RETURN_IF_ERROR(start.Encode(shard.instruction, config_.max_words).status());
  }
  const int64_t rows = static_cast<int64_t>(start.words().size()) + Vocabulary::kFirstWord;
  if (rows > config_.vocabulary_rows) {
    return absl::ResourceExhaustedError(
        absl::StrCat("the instructions need ", rows, " rows of the word table, it has ",
                     config_.vocabulary_rows, "; raise network.vocabulary_rows"));
  }
  return start;
}

void Demonstrations::MeasureNormalisation(NanoModel& model) const {
  Moments state(config_.state_dim), actions(config_.action_dim), aux(config_.aux_dim);
  for (const int64_t frame : training_) {
    const Shard& shard = ShardOf(frame);
    const int64_t i = frame - shard.first;
    state.Add(shard.state + i * config_.state_dim);
    if (shard.aux != nullptr) aux.Add(shard.aux + i * config_.aux_dim);
    for (int k = 0; k < config_.horizon; ++k) actions.Add(Action(shard, i, k).data());
  }
  model.state = state.Finish(kStateFloor);
  model.actions = actions.Finish(kActionFloor);
  model.aux = aux.Finish(kAuxFloor);
}

absl::StatusOr<DemoBatch> Demonstrations::Fill(absl::Span<const int64_t> frames,
                                               const NanoModel& model,
                                               const Augmentation& augmentation,
                                               RandomStream& random) const {
  const int64_t rows = static_cast<int64_t>(frames.size()), size = config_.image_size;
  const int64_t pixels = 3 * size * size;
  const int views = static_cast<int>(config_.cameras.size());
  std::vector<torch::Tensor> images;
  for (int v = 0; v < views; ++v) images.push_back(torch::empty({rows, size, size, 3}));
  DemoBatch batch;
  batch.words = torch::zeros({rows, config_.max_words}, torch::kInt64);
  batch.state = torch::empty({rows, config_.state_dim});
  batch.actions = torch::zeros({rows, config_.horizon, config_.model_action_dim});
  batch.aux = torch::zeros({rows, config_.aux_dim});
  int64_t longest = 1;
  const auto normalise = [](const float* row, const ZScore& z, float* out) {
    for (size_t j = 0; j < z.mean.size(); ++j)
      out[j] = (row[j] - z.mean[j]) / (z.std[j] + kStdEpsilon);
  };
  for (int64_t row = 0; row < rows; ++row) {
    const Shard& shard = ShardOf(frames[row]);
    const int64_t i = frames[row] - shard.first;
    for (int v = 0; v < views; ++v) {
      const int shift = augmentation.shift_px;
      const int dx = shift > 0 ? random.UniformInt(2 * shift + 1) - shift : 0;
      const int dy = shift > 0 ? random.UniformInt(2 * shift + 1) - shift : 0;
      float gain[3], offset[3];
      const double jitter = augmentation.colour_jitter;
      const double common = jitter > 0 ? random.Uniform(-jitter, jitter) : 0.0;
      for (int channel = 0; channel < 3; ++channel) {
        const double own = jitter > 0 ? random.Uniform(-jitter, jitter) : 0.0;
        gain[channel] = static_cast<float>((1.0 + 0.5 * common + 0.5 * own) / 127.5);
        offset[channel] =
            static_cast<float>(-1.0 + (jitter > 0 ? random.Uniform(-jitter, jitter) : 0.0));
      }
      ConvertImage(shard.images + (i * views + v) * pixels, static_cast<int>(size), dx, dy, gain,
                   offset, images[v].data_ptr<float>() + row * pixels);
    }
    RS_ASSIGN_OR_RETURN(const std::vector<int64_t> words,
                        model.vocabulary.Encode(shard.instruction, config_.max_words));
    std::copy(words.begin(), words.end(),
              batch.words.data_ptr<int64_t>() + row * config_.max_words);
    longest = std::max<int64_t>(
        longest, std::find(words.begin(), words.end(), Vocabulary::kPadding) - words.begin());
    float* state = batch.state.data_ptr<float>() + row * config_.state_dim;
    normalise(shard.state + i * config_.state_dim, model.state, state);
    if (augmentation.state_noise > 0) {
      for (int j = 0; j < config_.state_dim; ++j) {
        state[j] += static_cast<float>(augmentation.state_noise * random.Normal());
      }
    }
    for (int k = 0; k < config_.horizon; ++k) {
      normalise(
          Action(shard, i, k).data(), model.actions,
          batch.actions.data_ptr<float>() + (row * config_.horizon + k) * config_.model_action_dim);
    }
    if (shard.aux != nullptr) {
      normalise(shard.aux + i * config_.aux_dim, model.aux,
                batch.aux.data_ptr<float>() + row * config_.aux_dim);
    }
  }
  for (torch::Tensor& image : images) batch.images.push_back(image.permute({0, 3, 1, 2}));
  batch.words = batch.words.narrow(1, 0, longest).contiguous();
  return batch;
}

void Demonstrations::WillNeed(absl::Span<const int64_t> frames) const {
  const uintptr_t page = static_cast<uintptr_t>(sysconf(_SC_PAGESIZE));
  const size_t length =
      size_t{3} * config_.cameras.size() * config_.image_size * config_.image_size;
  for (const int64_t frame : frames) {
    const Shard& shard = ShardOf(frame);
    const uintptr_t begin =
        reinterpret_cast<uintptr_t>(shard.images + (frame - shard.first) * length);
    const uintptr_t aligned = begin / page * page;
    // Advice only: where it is refused the pages are read when they are touched.
    (void)madvise(reinterpret_cast<void*>(aligned), begin + length - aligned, MADV_WILLNEED);
  }
}

}  // namespace robostress
