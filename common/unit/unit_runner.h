#pragma once

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/records/episode_row.h"
#include "common/unit/unit_directory.h"
#include "common/unit/unit_plan.h"
#include "common/unit_config.h"

namespace robostress {

// A finished episode as the unit's files hold it.
struct PlayedEpisode {
  EpisodeRow row;
  TimingRow timing;
};

// Who serves the policy, where somebody else does.
struct PolicyServer {
  std::string url;        // without its query, which may hold a key
  std::string metadata;   // what it says of itself, as JSON
  int reconnections = 0;  // since Open
  bool operator==(const PolicyServer&) const = default;
};

// What a robot's worker brings to the runner: a policy and a way to play it. One thread.
class UnitPlayer {
 public:
  virtual ~UnitPlayer() = default;
  // Opens the policy; the hash of its weights, empty where it has none.
  virtual absl::StatusOr<std::string> Open() = 0;
  // What provenance.json says beside policy, hash and version; after Open.
  virtual std::map<std::string, std::string> Provenance() const { return {}; }
  // As it is now, after Open; absent for a policy of ours.
  virtual std::optional<PolicyServer> Server() const { return std::nullopt; }
  // Plays one episode, after those before it. May write files of its own beside the rows
  // (UnitDirectory::EpisodeFile).
  virtual absl::StatusOr<PlayedEpisode> Play(const PlannedEpisode& planned,
                                             UnitDirectory& directory) = 0;
  // What later episodes of an adapting method depend on: LoRA, Adam, buffer, counters. Absent where
  // the robot keeps no such state.
  virtual absl::StatusOr<std::optional<std::string>> Export() { return std::nullopt; }
  // Goes on from an exported state.
  virtual absl::Status Import(const std::string& /*state*/) {
    return absl::UnimplementedError("this robot takes up no session");
  }
};

struct UnitRunOptions {
  std::string out;       // directory, created
  std::string episodes;  // "40-59": that range only (PlanRange); empty: the whole unit
  std::function<void(std::string_view)> progress;  // one line per episode
};

// Runs what is missing of a unit and leaves `out` complete, DONE last. Interrupted at any point and
// called again, it gives the same episodes.jsonl as one uninterrupted call: it goes on after the
// last row, or begins anew where the robot's episodes do not stand alone (common/unit/robots.h). A
// finished unit returns at once, its player unopened. `resolved`: of ResolveUnit.
absl::Status RunUnit(const UnitConfig& resolved, const UnitRunOptions& options, UnitPlayer& player);

}  // namespace robostress
