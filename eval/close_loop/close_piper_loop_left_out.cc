#include "eval/close_loop/close_piper_loop.h"

// Stands in for close_piper_loop.cc in a build without robot_client/.
namespace robostress {

absl::StatusOr<ClosePiperLoopResult> ClosePiperLoop(const ClosePiperLoopOptions&) {
  return absl::UnimplementedError(
      "--arm piper needs the emulated Piper, and this build has ROBOSTRESS_ROBOT_CLIENT=OFF");
}

std::string ClosePiperLoopTable(const ClosePiperLoopResult&) { return ""; }

}  // namespace robostress
