#pragma once

#include <memory>
#include <string>

#include "common/unit/unit_runner.h"
#include "robot_client/study/table_suites.h"

namespace robostress::piper {

// Plays a unit in real time with the programs of a real arm: `piper_emulator` on a UDP bus where
// the arm would be, `robot_client` against the policy server, this process where the person would
// be, typing `home`, `start`, `success` and `failure`, and putting the objects back. The client's
// whole recording stays beside the rows, in client/.
class LivePlayer : public UnitPlayer {
 public:
  // UNIMPLEMENTED for suites of several object variants: a client is told one instruction. `unit`
  // (of ResolvePiperUnit) outlives the player; `folder` is the unit's, absolute.
  static absl::StatusOr<std::unique_ptr<LivePlayer>> Create(const UnitConfig& unit,
                                                            const std::string& server,
                                                            const std::string& folder);
  ~LivePlayer() override;

  absl::StatusOr<std::string> Open() override;
  absl::StatusOr<PlayedEpisode> Play(const PlannedEpisode& planned,
                                     UnitDirectory& directory) override;

 private:
  class Bench;
  LivePlayer(const UnitConfig& unit, std::string server, std::string folder);
  const UnitConfig& unit_;
  const std::string server_, folder_;
  std::unique_ptr<Bench> bench_;
};

}  // namespace robostress::piper
