#include "eval/report/result_checks.h"

#include <cmath>
#include <map>
#include <set>
#include <tuple>
#include <utility>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

// A mean whose cells are all in the file is theirs, with equal weights.
void CheckMeans(const ResultFile& file, std::vector<std::string>& complaints) {
  using Place = std::tuple<std::string, std::string, std::string, std::string>;
  std::map<Place, std::map<int, const ResultCell*>> levels;
  for (const ResultCell& cell : file.results)
    levels[{cell.policy, cell.suite, cell.method, cell.scenario}][cell.severity] = &cell;
  for (size_t i = 0; i < file.means.size(); ++i) {
    const ResultCell& mean = file.means[i];
    double sum = 0;
    int64_t n = 0;
    size_t found = 0;
    for (const std::string& scenario : mean.scenarios) {
      const auto& cells = levels[{mean.policy, mean.suite, mean.method, scenario}];
      auto cell = cells.find(mean.severity);
      if (cell == cells.end()) cell = cells.find(0);  // equal at every level
      if (cell == cells.end()) continue;
      sum += cell->second->rate;
      n += cell->second->counts.n;
      ++found;
    }
    if (found != mean.scenarios.size() || complaints.size() > kMostContradictions) continue;
    const double rate = sum / static_cast<double>(found);
    if (std::abs(mean.rate - rate) < kResultRounding && mean.counts.n == n) continue;
    complaints.push_back(absl::StrCat("means[", i, "]: rate is ", mean.rate, " and n ",
                                      mean.counts.n, ", its scenarios' results say ", rate, " and ",
                                      n));
  }
}

// What is declared once and named once.
class Declared {
 public:
  Declared(const ResultFile& file, std::vector<std::string>& complaints) : complaints_(complaints) {
    for (const ResultPolicy& policy : file.policies) Add("policy", policy.label);
    for (const ResultMethod& method : file.methods) Add("method", method.name);
    for (const ResultScenario& s : file.scenarios) Add("scenario", Leveled(s.name, s.severity));
    for (const ResultProtocol& protocol : file.protocols) Add("protocol", protocol.suite);
  }
  void Check(const std::vector<ResultCell>& cells, const char* where) {
    std::set<std::tuple<std::string, std::string, std::string, int, std::string>> seen;
    for (size_t i = 0; i < cells.size(); ++i) {
      const ResultCell& cell = cells[i];
      const std::string place = absl::StrCat(where, "[", i, "]");
      Has(place, "policy", cell.policy);
      Has(place, "method", cell.method);
      for (const auto& [control, difference] : cell.versus_control) Has(place, "method", control);
      if (cell.suite != "all") Has(place, "protocol", cell.suite);
      if (!cell.is_mean()) Has(place, "scenario", Leveled(cell.scenario, cell.severity));
      std::set<std::string> averaged;
      for (const std::string& scenario : cell.scenarios) {
        if (names_.count({"scenario", scenario}) == 0)  // not one that is equal at every level
          Has(place, "scenario", Leveled(scenario, cell.severity));
        if (!averaged.insert(scenario).second)
          Say(absl::StrCat(place, " names scenario ", scenario, " twice"));
      }
      if (!seen.insert({cell.policy, cell.suite, cell.scenario, cell.severity, cell.method}).second)
        Say(absl::StrCat(place, " stands twice: ", cell.policy, ", ", cell.suite, ", ",
                         cell.is_mean() ? "mean" : cell.scenario, ", ", cell.method));
    }
  }

 private:
  static std::string Leveled(const std::string& name, int severity) {
    return severity == 0 ? name : absl::StrCat(name, " at severity ", severity);
  }
  void Add(const std::string& kind, const std::string& name) {
    if (!names_.insert({kind, name}).second)
      Say(absl::StrCat(kind, " ", name, " is declared twice"));
  }
  void Has(const std::string& place, const std::string& kind, const std::string& name) {
    if (names_.count({kind, name}) == 0)
      Say(absl::StrCat(place, " names ", kind, " ", name, ", which the file does not declare"));
  }
  void Say(std::string text) {
    if (complaints_.size() <= kMostContradictions) complaints_.push_back(std::move(text));
  }

  std::set<std::pair<std::string, std::string>> names_;
  std::vector<std::string>& complaints_;
};

}  // namespace

std::vector<std::string> ContradictionsOf(const ResultFile& file) {
  std::vector<std::string> complaints;
  Declared declared(file, complaints);
  declared.Check(file.results, "results");
  declared.Check(file.means, "means");
  CheckMeans(file, complaints);
  return complaints;
}

}  // namespace robostress
