#pragma once

#include <memory>
#include <string>

#include "common/unit/unit_runner.h"
#include "robot_client/policy_link.h"
#include "robot_client/study/study_bench.h"
#include "robot_client/study/table_suites.h"

namespace robostress::piper {

// Plays a unit in simulated time: the classes of robot_client against an emulated arm. Between
// episodes the arm drives home and the objects are put back; an arm that cannot is power-cycled.
// LoRA, Adam and buffer begin with the session and are kept over the unit's episodes and object
// variants (paper, sec:supp_real). What happens is a function of unit and policy alone when the
// session is in lockstep.
class PiperPlayer : public UnitPlayer {
 public:
  // `unit`: of ResolvePiperUnit, outlives the player. `connect` opens the session.
  PiperPlayer(const UnitConfig& unit, PolicyLink::Connect connect);
  ~PiperPlayer() override;

  absl::StatusOr<std::string> Open() override;
  absl::StatusOr<PlayedEpisode> Play(const PlannedEpisode& planned,
                                     UnitDirectory& directory) override;

 private:
  class Table;
  const UnitConfig& unit_;
  const PolicyLink::Connect connect_;
  std::unique_ptr<Table> table_;
};

}  // namespace robostress::piper
