#include "tests/calibration/study/threshold_rates.h"

#include <algorithm>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress::generator {
using Json = nlohmann::json;

Traced ReadTraced(const Json& report, const Json& truth) {
  Traced rig;
  std::set<std::string> real;
  for (const Json& effect : truth["effects"]) {
    real.insert(effect["type"].get<std::string>());
    rig.outside |= !effect["in_library"].get<bool>();
  }
  rig.hidden = !real.empty() && !rig.outside;
  rig.right = true;
  for (const Json& effect : report["effects_added"]) {
    rig.added = true;
    const Json& others = effect["ambiguous_with"];
    rig.right &= real.count(effect["type"].get<std::string>()) > 0 ||
                 std::any_of(others.begin(), others.end(), [&](const Json& other) {
                   return real.count(other.get<std::string>()) > 0;
                 });
  }
  rig.right &= rig.added;
  rig.explained = 1;
  for (const Json& joint : report["joints"]) {
    const Json& noise = joint["times_noise"];
    rig.bulk = std::max(rig.bulk, noise["worst_log_bulk"].get<double>());
    rig.all = std::max(rig.all, noise["worst_log"].get<double>());
    if (joint["effects_added"].empty()) continue;
    rig.left = std::max(rig.left, noise["after"].get<double>());
    rig.explained = std::min(rig.explained, joint["excess_explained"].get<double>());
  }
  return rig;
}

namespace {

using Measure = double (*)(const Traced&);

// One row a limit: how many of `one` are above it, and how many of `other` are not.
std::string Rows(const std::string& rule, const std::vector<double>& limits, double now,
                 const std::vector<Traced>& one, const std::vector<Traced>& other, Measure of) {
  const auto above = [&](const std::vector<Traced>& rigs, double limit) {
    return std::count_if(rigs.begin(), rigs.end(),
                         [&](const Traced& rig) { return of(rig) > limit; });
  };
  std::string text;
  for (const double limit : limits)
    absl::StrAppendFormat(&text, "| %s | %g%s | %d | %d |\n", rule, limit,
                          limit == now ? ", as it is" : "", above(one, limit),
                          other.size() - above(other, limit));
  return text;
}

std::string Head(const std::string& one, size_t n_one, const std::string& other, size_t n_other) {
  return absl::StrFormat("| rule | limit | %s, of %d | %s, of %d |\n|---|---|---:|---:|\n", one,
                         n_one, other, n_other);
}

}  // namespace

std::string ThresholdRates(const std::vector<Traced>& rigs) {
  std::vector<Traced> nothing, hidden, right, wrong;
  for (const Traced& rig : rigs) {
    if (rig.hidden) hidden.push_back(rig);
    if (!rig.hidden && !rig.outside) nothing.push_back(rig);
    if (rig.added) (rig.right ? right : wrong).push_back(rig);
  }
  return absl::StrCat(
      Head("nothing hidden and yet above", nothing.size(), "hidden and not above", hidden.size()),
      Rows("declared model, bulk [noise]", {1.15, 1.3, 1.5, 1.75, 2, 3}, 1.5, nothing, hidden,
           [](const Traced& rig) { return rig.bulk; }),
      Rows("declared model, all runs [noise]", {1.5, 2, 4, 8, 12}, 4, nothing, hidden,
           [](const Traced& rig) { return rig.all; }),
      "\n",
      Head("all right and yet above: no name", right.size(), "not all right and not above: a name",
           wrong.size()),
      Rows("left under a name [noise]", {1.15, 1.5, 2, 3, 5, 10}, 3, right, wrong,
           [](const Traced& rig) { return rig.left; }),
      Rows("excess not explained [%]", {0.3, 1, 3, 10, 30}, 3, right, wrong,
           [](const Traced& rig) { return 100 * (1 - rig.explained); }));
}

}  // namespace robostress::generator
