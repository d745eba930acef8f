#pragma once

#include <string>

#include "absl/status/status.h"
#include "eval/piper_study/piper_study.h"

namespace robostress {

// Plays one unit in real time with the programs of a real arm: `piper_emulator` on a UDP bus where
// the arm would be, `robot_client` against the policy server, this process where the person would
// be, typing `home`, `start`, `success` and `failure`, and putting the objects back. Writes
// live/<id>/episodes.jsonl with the rows of units/<id>, client/ (the client's whole recording) and
// DONE last. UNIMPLEMENTED for the object variants: a client is told one instruction.
absl::Status RunLiveUnit(const PiperStudyOptions& options, const PiperUnit& unit,
                         const std::string& weights, const std::string& server,
                         const PiperStudyLaunch& launch);

}  // namespace robostress
