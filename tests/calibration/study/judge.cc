#include "tests/calibration/study/judge.h"

#include <algorithm>
#include <boost/math/distributions/binomial.hpp>
#include <set>

namespace robostress::generator {
using Json = nlohmann::json;

const char* OutcomeName(Outcome outcome) {
  constexpr const char* kNames[] = {"named",      "in group",    "listed", "hedged",
                                    "one of two", "missed",      "wrong",  "wrong group",
                                    "nothing",    "false alarm", "refused"};
  return kNames[static_cast<int>(outcome)];
}

namespace {

constexpr double kNoise = 1.15;  // times the noise of the readings

// In the joint where most is left, after what was added.
double TimesNoiseLeft(const Json& report) {
  double left = 0;
  for (const Json& joint : report["joints"])
    left = std::max(left, joint["times_noise"]["after"].get<double>());
  return left;
}

}  // namespace

Judged Judge(const Json& report, const Json& truth) {
  Judged judged;
  const std::string verdict = report.value("verdict", "");
  std::set<std::string> added, around;
  judged.said = verdict;
  for (const Json& effect : report["effects_added"]) {
    const std::string type = effect["type"];
    added.insert(type);
    around.insert(type);
    judged.said += " " + type;
    if (report["joints"].size() > 1) judged.said += "@" + effect["joint"].get<std::string>();
    for (const Json& other : effect["ambiguous_with"]) {
      around.insert(other.get<std::string>());
      judged.said += "|" + other.get<std::string>();
    }
  }
  for (const Json& group : report["groups"]) {
    if (std::any_of(group.begin(), group.end(),
                    [&](const Json& name) { return added.count(name.get<std::string>()) > 0; }))
      for (const Json& name : group) around.insert(name.get<std::string>());
  }
  // Effects of the whole arm show at every joint.
  const auto place = [](const Json& effect) {
    const std::string type = effect["type"];
    const bool whole = type == "payload" || type == "base_tilt";
    return whole ? type : type + "@" + effect["joint"].get<std::string>();
  };
  std::set<std::string> places, found;
  for (const Json& effect : truth["effects"]) places.insert(place(effect));
  for (const Json& effect : report["effects_added"]) found.insert(place(effect));
  std::set<std::string> real, near;
  bool outside = false;
  for (const Json& effect : truth["effects"]) {
    real.insert(effect["type"].get<std::string>());
    outside |= !effect["in_library"].get<bool>();
    for (const Json& name : effect["near"]) near.insert(name.get<std::string>());
  }
  const auto holds = [](const std::set<std::string>& all, const std::set<std::string>& some) {
    return std::includes(all.begin(), all.end(), some.begin(), some.end());
  };
  const bool one_of_two =
      !outside && places.size() == 2 && !holds(around, real) &&
      std::any_of(real.begin(), real.end(),
                  [&](const std::string& name) { return around.count(name) > 0; }) &&
      (verdict == "ambiguous" || (verdict == "attributed" && holds(places, found))) &&
      TimesNoiseLeft(report) <= kNoise;
  const bool silent = verdict == "declared_sufficient" || verdict == "not_testable";
  if (real.empty()) {
    judged.outcome = silent ? Outcome::kNothing : Outcome::kFalseAlarm;
  } else if (silent) {
    judged.outcome = Outcome::kMissed;
  } else if (one_of_two) {
    judged.outcome = Outcome::kOneOfTwo;
  } else if (verdict == "attributed") {
    judged.outcome = found == places                                  ? Outcome::kNamed
                     : outside && !near.empty() && holds(near, added) ? Outcome::kListed
                                                                      : Outcome::kWrong;
  } else if (verdict == "ambiguous") {
    judged.outcome =
        outside ? (!near.empty() && holds(near, added) ? Outcome::kListed : Outcome::kWrongGroup)
        : holds(around, real) ? Outcome::kGrouped
                              : Outcome::kWrongGroup;
  } else {
    judged.outcome = !outside && holds(around, real) ? Outcome::kListed : Outcome::kHedged;
  }
  return judged;
}

std::pair<double, double> ClopperPearson(int count, int n, double confidence) {
  if (n == 0) return {0, 1};
  using Binomial = boost::math::binomial;
  const double tail = (1 - confidence) / 2;
  return {Binomial::find_lower_bound_on_p(n, count, tail),
          Binomial::find_upper_bound_on_p(n, count, tail)};
}

}  // namespace robostress::generator
