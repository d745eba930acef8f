#include "tests/server/training/toy_world.h"

#include <algorithm>
#include <cmath>
#include <map>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

struct Colour {
  const char* name;
  double rgb[3];
};
constexpr Colour kColours[] = {{"red", {200, 40, 40}},     {"green", {50, 160, 60}},
                               {"blue", {50, 80, 200}},    {"yellow", {210, 190, 60}},
                               {"purple", {130, 60, 150}}, {"white", {225, 225, 225}}};
constexpr int kNumColours = 6, kBlocks = 3, kPlates = 2;
constexpr double kReach = 0.25;                 // half width of the table [m]
constexpr double kStepGain = 0.05 * 0.25;       // motion per step of a full command [m]
constexpr double kHover = 0.10, kGrasp = 0.02;  // heights [m]
constexpr double kOpen = 0.04, kClosed = 0.02;  // finger opening [m]

}  // namespace

ToyWorld::ToyWorld(RandomStream random) {
  const auto place = [&] {
    return Eigen::Vector2d(random.Uniform(-0.2, 0.2), random.Uniform(-0.2, 0.2));
  };
  std::vector<Eigen::Vector2d> taken;
  const auto place_apart = [&] {
    Eigen::Vector2d spot = place();
    while (std::any_of(taken.begin(), taken.end(),
                       [&](const auto& other) { return (other - spot).norm() < 0.09; })) {
      spot = place();
    }
    taken.push_back(spot);
    return spot;
  };
  const auto colours = [&](int count) {
    std::vector<int> order(kNumColours);
    for (int i = 0; i < kNumColours; ++i) order[i] = i;
    for (int i = 0; i < count; ++i)
      std::swap(order[i], order[i + random.UniformInt(kNumColours - i)]);
    order.resize(count);
    return order;
  };
  block_colours_ = colours(kBlocks);
  plate_colours_ = colours(kPlates);
  for (int i = 0; i < kBlocks; ++i) state_.blocks.push_back(place_apart());
  for (int i = 0; i < kPlates; ++i) plates_.push_back(place_apart());
  state_.tool = {random.Uniform(-0.2, 0.2), random.Uniform(-0.2, 0.2), random.Uniform(0.1, 0.2)};
  instruction_ = absl::StrCat("pick up the ", kColours[block_colours_[target_]].name,
                              " block and put it on the ",
                              kColours[plate_colours_[destination_]].name, " plate");
}

Image ToyWorld::Draw(bool from_hand) const {
  Image image{kImageSize, kImageSize, std::vector<uint8_t>(3 * kImageSize * kImageSize)};
  const double view = from_hand ? 0.1 + state_.tool.z() : 2.2 * kReach;  // width of the view [m]
  const Eigen::Vector2d centre =
      from_hand ? Eigen::Vector2d(state_.tool.head<2>()) : Eigen::Vector2d(0, 0);
  constexpr int kSub = 2;  // samples per pixel and axis
  for (int row = 0; row < kImageSize; ++row) {
    for (int col = 0; col < kImageSize; ++col) {
      double sum[3] = {0, 0, 0};
      for (int s = 0; s < kSub * kSub; ++s) {
        const int across = s % kSub, down = s / kSub;
        const double px = (col + (across + 0.5) / kSub) / kImageSize - 0.5;
        const double py = (row + (down + 0.5) / kSub) / kImageSize - 0.5;
        const Eigen::Vector2d p = centre + view * Eigen::Vector2d(px, py);
        double rgb[3] = {150, 125, 100};
        const auto paint = [&](const Colour& colour, double shade) {
          for (int c = 0; c < 3; ++c) rgb[c] = colour.rgb[c] * shade;
        };
        for (int i = 0; i < kPlates; ++i) {
          const double r = (p - plates_[i]).norm();
          if (r < 0.045) paint(kColours[plate_colours_[i]], r > 0.035 ? 0.7 : 1.0);
        }
        for (int i = 0; i < kBlocks; ++i) {
          if ((p - state_.blocks[i]).cwiseAbs().maxCoeff() < 0.02)
            paint(kColours[block_colours_[i]], 0.9);
        }
        const Eigen::Vector2d d = p - state_.tool.head<2>();
        const double finger = std::abs(std::abs(d.x()) - state_.finger);
        if (!from_hand && finger < 0.008 && std::abs(d.y()) < 0.01 + 0.1 * state_.tool.z())
          paint({"", {30, 30, 30}}, 1);
        for (int c = 0; c < 3; ++c) sum[c] += rgb[c];
      }
      for (int c = 0; c < 3; ++c) {
        image.data[3 * (row * kImageSize + col) + c] = static_cast<uint8_t>(sum[c] / (kSub * kSub));
      }
    }
  }
  return image;
}

Observation ToyWorld::Observe() const {
  Observation observation;
  observation.instruction = instruction_;
  observation.views = {{"agentview", Draw(false)}, {"robot0_eye_in_hand", Draw(true)}};
  observation.proprioception = Eigen::VectorXf::Zero(8);
  observation.proprioception.head<3>() = state_.tool.cast<float>();
  observation.proprioception[6] = static_cast<float>(state_.finger);
  observation.proprioception[7] = static_cast<float>(-state_.finger);
  return observation;
}

Eigen::VectorXf ToyWorld::Expert(const State& state) const {
  Eigen::VectorXf action = Eigen::VectorXf::Zero(7);
  const bool done = Success(state);
  const Eigen::Vector2d spot = state.holding ? plates_[destination_] : state.blocks[target_];
  const double away = (spot - state.tool.head<2>()).norm();
  const bool over = away < 0.012 || (away < 0.02 && state.tool.z() < kHover - 0.02);
  Eigen::Vector3d goal(spot.x(), spot.y(), over ? kGrasp : kHover);
  const bool at_goal = over && std::abs(state.tool.z() - kGrasp) < 0.008;
  action[6] = state.holding ? 1.0f : -1.0f;
  if (at_goal) action[6] = -action[6];
  if (done) {
    action[6] = -1.0f;
    return action;
  }
  if (!over && state.tool.z() < kHover - 0.03) goal.head<2>() = state.tool.head<2>();  // up first
  action.head<3>() = ((goal - state.tool) / 0.05).cwiseMax(-0.9).cwiseMin(0.9).cast<float>();
  return action;
}

void ToyWorld::Advance(State& state, const Eigen::VectorXf& action, int target) {
  const Eigen::Vector3d command = action.head<3>().cast<double>().cwiseMax(-1).cwiseMin(1);
  state.tool += kStepGain * command;
  state.tool.z() = std::max(0.01, state.tool.z());
  const bool close = action[6] > 0;
  state.finger = std::clamp(state.finger + (close ? -0.01 : 0.01), kClosed, kOpen);
  if (!close) state.holding = false;
  if (close && !state.holding && state.finger <= kClosed && state.tool.z() < 0.035 &&
      (state.blocks[target] - state.tool.head<2>()).norm() < 0.015) {
    state.holding = true;
  }
  if (state.holding) state.blocks[target] = state.tool.head<2>();
}

void ToyWorld::Step(const Eigen::VectorXf& action) { Advance(state_, action, target_); }

bool ToyWorld::Success(const State& state) const {
  return !state.holding && state.finger > 0.025 &&
         (state.blocks[target_] - plates_[destination_]).norm() < 0.025;
}

bool ToyWorld::success() const { return Success(state_); }

Eigen::MatrixXf ToyWorld::ExpertChunk() const {
  State state = state_;
  Eigen::MatrixXf chunk(kHorizon, 7);
  for (int k = 0; k < kHorizon; ++k) {
    const Eigen::VectorXf action = Expert(state);
    chunk.row(k) = action.transpose();
    Advance(state, action, target_);
  }
  return chunk;
}

Eigen::Matrix<float, 8, 1> ToyWorld::Aux() const {
  Eigen::Matrix<float, 8, 1> aux;
  aux << static_cast<float>(state_.blocks[target_].x()),
      static_cast<float>(state_.blocks[target_].y()), 0.0f,
      static_cast<float>(plates_[destination_].x()), static_cast<float>(plates_[destination_].y()),
      0.0f, state_.holding ? 1.0f : 0.0f, state_.holding ? 0.5f : 0.0f;
  return aux;
}

absl::Status WriteToyDemonstrations(const std::string& directory, int episodes, int stride,
                                    uint64_t seed) {
  struct Task {
    std::vector<uint8_t> images;
    std::vector<float> state, actions, aux;
    std::vector<int64_t> episode;
  };
  RS_RETURN_IF_ERROR(MakeDirectories(directory));
  std::map<std::string, Task> tasks;
  for (int episode = 0; episode < episodes; ++episode) {
    const StreamKey key = StreamKey("toy").With(static_cast<int64_t>(seed)).With(episode);
    ToyWorld world{RandomStream(key.With("scene"))};
    RandomStream random(key.With("noise"));
    Task& task = tasks[world.instruction()];
    Eigen::Vector3f burst = Eigen::Vector3f::Zero();
    int burst_left = 0;
    for (int step = 0; step < 150 && !world.success(); ++step) {
      const Eigen::MatrixXf chunk = world.ExpertChunk();
      if (step % stride == 0) {
        const Observation observation = world.Observe();
        for (const CameraView& view : observation.views) {
          task.images.insert(task.images.end(), view.image.data.begin(), view.image.data.end());
        }
        const Eigen::VectorXf& state = observation.proprioception;
        task.state.insert(task.state.end(), state.data(), state.data() + 8);
        for (int k = 0; k < ToyWorld::kHorizon; ++k) {
          for (int j = 0; j < 7; ++j) task.actions.push_back(chunk(k, j));
        }
        const auto aux = world.Aux();
        task.aux.insert(task.aux.end(), aux.data(), aux.data() + 8);
        task.episode.push_back(episode);
      }
      if (burst_left == 0 && random.Uniform() < 0.05) {
        burst_left = 2 + random.UniformInt(6);
        for (int j = 0; j < 3; ++j) burst[j] = static_cast<float>(0.5 * random.Normal());
      }
      Eigen::VectorXf action = chunk.row(0).transpose();
      if (burst_left > 0) {
        action.head<3>() += burst;
        --burst_left;
      }
      world.Step(action);
    }
  }
  int index = 0;
  for (const auto& [instruction, task] : tasks) {
    const int64_t frames = static_cast<int64_t>(task.episode.size()), size = ToyWorld::kImageSize;
    SafetensorsWriter writer;
    writer.SetMetadata("suite", "toy");
    writer.SetMetadata("task", absl::StrCat(index));
    writer.SetMetadata("instruction", instruction);
    writer.SetMetadata("version", "1");
    writer.Add("images", DType::kU8, {frames, 2, size, size, 3}, task.images.data(),
               task.images.size());
    writer.AddFloats("state", {frames, 8}, task.state);
    writer.AddFloats("actions", {frames, ToyWorld::kHorizon, 7}, task.actions);
    writer.AddFloats("aux", {frames, 8}, task.aux);
    writer.AddInts("episode", {frames}, task.episode);
    RS_RETURN_IF_ERROR(writer.Write(absl::StrCat(directory, "/toy_", index++, ".safetensors")));
  }
  return absl::OkStatus();
}

}  // namespace robostress
