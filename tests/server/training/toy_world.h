#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/random.h"
#include "common/types.h"

namespace robostress {

// A pick-and-place world without physics, for trying training and policies before there is a
// simulator: coloured blocks and plates on a table, seen from above and from the hand; the
// instruction names a block and a plate; the tool follows the commands as a first-order arm would.
class ToyWorld {
 public:
  static constexpr int kImageSize = 64;
  static constexpr int kHorizon = 50;  // steps of an action label

  explicit ToyWorld(RandomStream random);

  const std::string& instruction() const { return instruction_; }
  Observation Observe() const;
  // The scripted expert's next commands, were nothing to disturb it.
  Eigen::MatrixXf ExpertChunk() const;  // [kHorizon, 7]
  void Step(const Eigen::VectorXf& action);
  bool success() const;
  // Target position, destination, holding, progress.
  Eigen::Matrix<float, 8, 1> Aux() const;

 private:
  struct State {
    Eigen::Vector3d tool;
    double finger = 0.04;  // opening [m]
    bool holding = false;
    std::vector<Eigen::Vector2d> blocks;
    double block_height = 0;  // of the held block [m]
  };
  Eigen::VectorXf Expert(const State& state) const;
  static void Advance(State& state, const Eigen::VectorXf& action, int target);
  bool Success(const State& state) const;
  Image Draw(bool from_hand) const;

  State state_;
  std::vector<int> block_colours_, plate_colours_;
  std::vector<Eigen::Vector2d> plates_;
  int target_ = 0, destination_ = 0;
  std::string instruction_;
};

// Writes demonstrations in the format of robostress-record: one shard per pair of colours.
absl::Status WriteToyDemonstrations(const std::string& directory, int episodes, int stride,
                                    uint64_t seed);

}  // namespace robostress
