#pragma once

#include <string>
#include <vector>

#include "absl/time/time.h"

namespace robostress {

// A session in memory, as far as it matters to who gives up its place.
struct HeldPlace {
  std::string id;
  std::string client;         // Caller::client()
  absl::Duration idle;        // since its last message
  bool attached = false;      // a connection serves it
  bool was_attached = false;  // one did, at some time
  bool learned = false;       // feedback is in it
};

struct PlaceRules {
  int places = 64;
  bool durable = false;  // it goes to disk and comes back with its next message; else it is closed
  // Unused for this long a session gives up its place, whatever it is ...
  absl::Duration abandoned_after = absl::Minutes(15);
  // ... earlier where that costs less, or is fair. None of these counts beyond abandoned_after.
  absl::Duration durable_after = absl::Seconds(10);     // to disk
  absl::Duration unattached_after = absl::Seconds(30);  // opened, and never served
  absl::Duration over_share_after = absl::Minutes(1);   // of a client with more than its share
};

struct PlaceChoice {
  std::string victim;   // empty: none yet
  absl::Duration wait;  // until there is one, if nothing is used till then
};

// Who makes room for a session of `newcomer`. `held`: only those that may go at all (no message
// under way). A client's share is the places over the clients that hold or want one.
//
// At once: what no connection serves any more, where it is durable or has learned nothing. Of those
// that may go: first of the client that holds most beyond its share, then what no connection
// serves, then what is unused for longest.
PlaceChoice ChoosePlace(const PlaceRules& rules, const std::vector<HeldPlace>& held,
                        const std::string& newcomer);

}  // namespace robostress
