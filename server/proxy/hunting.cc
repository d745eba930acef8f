#include "server/proxy/hunting.h"

#include <cmath>

namespace robostress {
namespace {

constexpr int kAnswers = 12;
constexpr size_t kTurns = 5;

}  // namespace

std::optional<Eigen::Index> HuntingWatch::Add(const Eigen::VectorXd& correction) {
  std::optional<Eigen::Index> hunts;
  for (Eigen::Index j = 0; j < correction.size(); ++j) {
    Column& column = columns_[static_cast<size_t>(j)];
    for (int& turn : column.turns) ++turn;
    if (!column.turns.empty() && column.turns.front() >= kAnswers)
      column.turns.erase(column.turns.begin());
    const double way = correction[j] - column.extreme;
    if (way * column.direction >= 0 && column.direction != 0) {
      column.extreme = correction[j];
    } else if (std::abs(way) > swing_[j]) {
      column.turns.push_back(0);
      column.direction = std::copysign(1, way);
      column.extreme = correction[j];
    }
    if (column.turns.size() >= kTurns) hunts = j;
  }
  return hunts;
}

}  // namespace robostress
