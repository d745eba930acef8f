#include "eval/report/paper_values.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace robostress {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr char kSimulated[] =
    "four LIBERO suites of ten tasks, 20 episodes per task, three seeds, MuJoCo 3.7";

// Scenarios in the order of the tables.
std::vector<std::string> Scenarios(bool clean, bool average) {
  std::vector<std::string> rows = {
      "heavy_payload",      "thermal_drift_stribeck", "thermal_drift_backlash", "aged_transmission",
      "aged_joint_uniform", "aged_joint_shoulder",    "aged_joint_elbow"};
  if (clean) rows.insert(rows.begin(), "clean");
  if (average) rows.push_back("average");
  return rows;
}

std::vector<PublishedTable> MakeTables() {
  std::vector<PublishedTable> tables;
  tables.push_back({"main",
                    "tab:realistic",
                    "Success rates (%) on RoboStress deployment scenarios; averages exclude Clean",
                    kSimulated,
                    Scenarios(true, true),
                    {{"pi0.5",
                      {"Base", "DR", "RobustVLA", "Ours"},
                      {{97.0, 97.1, 96.6, 95.8},
                       {44.1, 42.1, 38.9, 56.8},
                       {54.1, 54.6, 55.9, 60.5},
                       {83.4, 84.5, 83.1, 84.8},
                       {33.2, 39.7, 40.2, 41.8},
                       {29.5, 36.0, 33.8, 38.6},
                       {43.9, 46.4, 43.0, 51.2},
                       {55.6, 54.0, 53.9, 62.3},
                       {49.1, 51.0, 49.8, 56.6}}},
                     {"pi0",
                      {"Base", "DR", "RobustVLA", "Ours"},
                      {{91.1, 90.5, 92.0, 92.6},
                       {42.3, 32.0, 30.9, 42.8},
                       {46.1, 46.3, 46.0, 50.6},
                       {75.5, 77.3, 77.3, 78.8},
                       {26.8, 22.9, 23.8, 28.9},
                       {23.0, 22.4, 20.0, 24.0},
                       {34.5, 32.9, 31.5, 39.2},
                       {43.9, 44.5, 42.2, 44.9},
                       {41.7, 39.8, 38.8, 44.2}}}}});
  tables.push_back({"noise",
                    "tab:unit",
                    "Single noise components, the others off; success (%)",
                    kSimulated,
                    {"isolated_stribeck", "isolated_backlash", "isolated_compliance",
                     "isolated_gravity", "average"},
                    {{"pi0",
                      {"Base", "Ours"},
                      {{36.8, 37.8}, {68.0, 72.1}, {74.1, 74.2}, {21.1, 22.0}, {50.0, 51.5}}}}});
  tables.push_back(
      {"ablation",
       "tab:no-residual",
       "Method ablation: success (%), average over the seven scenarios",
       kSimulated,
       {"average"},
       {{"pi0", {"Base", "Direct", "w/o residual", "Ours"}, {{41.7, 23.6, 40.8, 44.2}}}}});
  tables.push_back({"anchor",
                    "tab:anchor-ablation",
                    "Effect of the anchor loss; success (%)",
                    kSimulated,
                    Scenarios(false, true),
                    {{"pi0",
                      {"w/o anchor", "w/ anchor"},
                      {{38.2, 42.8},
                       {50.4, 50.6},
                       {77.9, 78.8},
                       {25.2, 28.9},
                       {22.8, 24.0},
                       {35.5, 39.2},
                       {42.8, 44.9},
                       {41.8, 44.2}}}}});
  tables.push_back({"dob",
                    "tab:feedback_comparison",
                    "Effect of a disturbance observer; success (%), Task 1 of Robot A",
                    "a new AgileX Piper, pi0.5 fine-tuned on 30 teleoperated demonstrations, 25 "
                    "episodes",
                    {"1"},
                    {{"pi0.5", {"Base", "DOB", "Ours", "DOB+Ours"}, {{48, 56, 84, 80}}}}});
  // Only what sec:supp_severity_levels says in words; its figure has no numbers.
  tables.push_back({"severity",
                    "fig:supp_severity",
                    "Success (%) over severity levels L1 (mild) to L5 (full)",
                    kSimulated,
                    Scenarios(false, false),
                    {{"pi0.5",
                      {"Ours L1", "Ours L5"},
                      {{84.3, 56.8},
                       {65.2, 60.5},
                       {92.4, 84.8},
                       {kNaN, 41.8},
                       {kNaN, 38.6},
                       {kNaN, 51.2},
                       {kNaN, 62.3}}}}});
  tables.push_back(
      {"residual",
       "tab:residual-magnitude",
       "Residual magnitude ||eta|| / ||a|| (%), mean over rollouts of the base policy",
       "pi0; simulation: end-effector residual in normalised action units, 20 Hz; "
       "Piper arms: joint-space residual in radians, 30 Hz",
       [] {
         std::vector<std::string> rows = Scenarios(true, false);
         rows.insert(rows.end(), {"new", "used_one_year"});
         return rows;
       }(),
       {{"pi0",
         {"Residual"},
         {{23.4}, {48.6}, {47.5}, {46.1}, {38.7}, {48.2}, {56.3}, {47.0}, {32.9}, {35.0}}}}});
  tables.push_back({"payload",
                    "fig:fidelity",
                    "Deviation of the end effector under a real payload, Heavy Payload and "
                    "Gaussian action noise",
                    "a pick-and-place demonstration replayed three times on a Piper with 1 kg; ten "
                    "initial layouts in simulation. The figure has no numbers: Heavy Payload shows "
                    "the rise after the grasp and is nearer to the real mean profile (DTW) than "
                    "Gaussian noise",
                    {},
                    {}});
  tables.push_back({"real-arm",
                    "tab:real",
                    "Success rates (%) on two Piper arms",
                    "Robot A is new, Robot B was used for one year; policies fine-tuned on 30 "
                    "teleoperated demonstrations per task and arm; 25 episodes per task",
                    {"1", "2", "3", "4", "average"},
                    {{"Robot A, pi0.5",
                      {"Base", "RobustVLA", "Ours"},
                      {{48, 52, 84}, {36, 60, 76}, {48, 48, 76}, {40, 48, 68}, {43, 52, 76}}},
                     {"Robot A, pi0",
                      {"Base", "RobustVLA", "Ours"},
                      {{44, 52, 76}, {40, 28, 80}, {44, 68, 72}, {32, 40, 60}, {40, 47, 72}}},
                     {"Robot B, pi0.5",
                      {"Base", "RobustVLA", "Ours"},
                      {{44, 56, 80}, {36, 48, 72}, {56, 52, 84}, {36, 44, 60}, {43, 50, 74}}},
                     {"Robot B, pi0",
                      {"Base", "RobustVLA", "Ours"},
                      {{36, 56, 60}, {32, 52, 84}, {52, 44, 84}, {32, 44, 56}, {38, 49, 71}}}}});
  tables.push_back({"unseen",
                    "fig:ood",
                    "Objects unseen during fine-tuning: success (%), Task 1 on Robot A",
                    "five variants of bowl or plate with reworded instructions, five episodes "
                    "each, pi0.5; the adapter is kept across variants",
                    {"1"},
                    {{"pi0.5", {"Base", "RobustVLA", "Ours"}, {{16, 36, 64}}}}});
  return tables;
}

std::vector<PaperRow> MakeRows() {
  const PublishedTable &main = *FindPublished("main"), &residual = *FindPublished("residual");
  std::vector<PaperRow> rows;
  double sum = 0;
  for (size_t r = 0; r < main.rows.size(); ++r) {
    const int at = residual.RowOf(main.rows[r]);
    // The average stands last, without Clean.
    const double magnitude =
        at < 0 ? std::round(10 * sum / 7) / 10 : residual.groups[0].values[at][0];
    if (at > 0) sum += magnitude;
    const auto &pi05 = main.groups[0].values[r], &pi0 = main.groups[1].values[r];
    rows.push_back({main.rows[r], magnitude, pi0[0], pi0[3], pi05[0], pi05[3]});
  }
  return rows;
}

const std::vector<PaperRow>& RowsAndAverage() {
  static const auto& rows = *new std::vector<PaperRow>(MakeRows());
  return rows;
}

}  // namespace

int PublishedTable::RowOf(const std::string& row) const {
  const auto found = std::find(rows.begin(), rows.end(), row);
  return found == rows.end() ? -1 : static_cast<int>(found - rows.begin());
}

const std::vector<PublishedTable>& PublishedTables() {
  static const auto& tables = *new std::vector<PublishedTable>(MakeTables());
  return tables;
}

const PublishedTable* FindPublished(const std::string& name) {
  for (const PublishedTable& table : PublishedTables()) {
    if (table.name == name) return &table;
  }
  return nullptr;
}

const std::vector<PaperRow>& PaperRows() {
  static const auto& rows =
      *new std::vector<PaperRow>(RowsAndAverage().begin(), RowsAndAverage().end() - 1);
  return rows;
}

const PaperRow* FindPaperRow(const std::string& scenario) {
  for (const PaperRow& row : PaperRows()) {
    if (scenario == row.scenario) return &row;
  }
  return nullptr;
}

const PaperRow& PaperAverage() { return RowsAndAverage().back(); }

}  // namespace robostress
