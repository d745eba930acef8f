#include "server/sessions/place_choice.h"

#include <algorithm>
#include <map>
#include <tuple>

namespace robostress {
namespace {

// Unused for how long it may go.
absl::Duration GoesAfter(const PlaceRules& rules, const HeldPlace& place, bool over_share) {
  const bool detached = place.was_attached && !place.attached;
  if (detached && (rules.durable || !place.learned)) return absl::ZeroDuration();
  absl::Duration after = rules.abandoned_after;
  if (rules.durable) after = std::min(after, rules.durable_after);
  if (!place.was_attached && !place.learned) after = std::min(after, rules.unattached_after);
  if (over_share) after = std::min(after, rules.over_share_after);
  return after;
}

}  // namespace

PlaceChoice ChoosePlace(const PlaceRules& rules, const std::vector<HeldPlace>& held,
                        const std::string& newcomer) {
  std::map<std::string, int> clients{{newcomer, 0}};
  for (const HeldPlace& place : held) ++clients[place.client];
  const auto n = static_cast<int>(clients.size());
  const int share = (rules.places + n - 1) / n;
  PlaceChoice choice{"", rules.abandoned_after};
  std::tuple<int, bool, absl::Duration> best;
  for (const HeldPlace& place : held) {
    const int beyond = std::max(0, clients[place.client] - share);
    const absl::Duration left = GoesAfter(rules, place, beyond > 0) - place.idle;
    choice.wait = std::min(choice.wait, std::max(left, absl::ZeroDuration()));
    if (left > absl::ZeroDuration()) continue;
    const std::tuple rank{beyond, !place.attached, place.idle};
    if (choice.victim.empty() || rank > best) {
      choice.victim = place.id;
      best = rank;
    }
  }
  return choice;
}

}  // namespace robostress
