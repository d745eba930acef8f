#pragma once

#include <string>
#include <vector>

#include "eval/paper/paper_table.h"

// The real-arm tables, on emulated Pipers: rows are suites of the table, columns belong to arms.
namespace robostress {

// An arm of the paper: a wear profile of the emulator and what tables call it.
struct PiperArmColumn {
  std::string scenario;  // "new", "used_one_year", or a scenario file
  std::string title;     // "emulated Robot A"
};
// Arms by their order: the first is the paper's Robot A.
std::vector<PiperArmColumn> PiperArms(const std::vector<std::string>& scenarios);

// `tasks`: the paper's numbers, 1 to 4.
PaperTable RealArmTable(const std::vector<PiperArmColumn>& arms, const std::vector<int>& tasks);
PaperTable ObserverTable(const PiperArmColumn& arm, int task);
PaperTable UnseenTable(const PiperArmColumn& arm);

// 25 episodes of each unit, one seed, the weights that a study trains in `folder`.
PaperProtocol PiperProtocol(const std::string& folder);

}  // namespace robostress
