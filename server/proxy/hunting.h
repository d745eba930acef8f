#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

namespace robostress {

// Sees that a correction hunts: it swings to and fro by more than half of its limit, five times
// within twelve answers. So it does where `nominal` is not the arm's, or where the arm answers
// later than the method can know. One thread.
class HuntingWatch {
 public:
  // `limit`: of each column, above 0.
  explicit HuntingWatch(const Eigen::VectorXd& limit) : swing_(limit / 2), columns_(limit.size()) {}

  // Another motion begins; the correction is 0.
  void Reset() { columns_.assign(columns_.size(), {}); }
  // The correction of the next answer; the column that hunts.
  std::optional<Eigen::Index> Add(const Eigen::VectorXd& correction);

 private:
  struct Column {
    double extreme = 0, direction = 0;  // since the last turn; 0: it has not moved yet
    std::vector<int> turns;             // answers ago
  };

  Eigen::VectorXd swing_;
  std::vector<Column> columns_;
};

}  // namespace robostress
