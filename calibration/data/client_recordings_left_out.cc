#include <filesystem>

#include "absl/strings/str_cat.h"
#include "calibration/data/client_recordings.h"

// Stands in for client_recordings.cc in a build without robot_client/, whose arm it would describe.
namespace robostress::calibration {

bool IsClientRun(const std::string& run) {
  const std::filesystem::path folder = run;
  return std::filesystem::exists(folder / "ticks.csv") ||
         std::filesystem::exists(folder / "ticks.csv.partial");
}

absl::StatusOr<std::vector<RecordedEpisode>> EpisodesOfClientRun(const std::string& run, int) {
  return absl::UnimplementedError(
      absl::StrCat(run,
                   ": is a run of robot_client, and this build has "
                   "ROBOSTRESS_ROBOT_CLIENT=OFF; configure it ON to read one"));
}

absl::StatusOr<std::optional<std::vector<std::string>>> JointNamesOfClientRun(const std::string&) {
  return std::nullopt;
}

RecordedArm ArmResponse(const std::string&, int) { return {}; }

RecordedArm PiperOfRecordings(const std::string&, double) { return {}; }

}  // namespace robostress::calibration
