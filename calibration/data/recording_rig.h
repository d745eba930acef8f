#pragma once

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recording_plan.h"

namespace robostress::calibration {

struct RecordingRigSummary {
  std::string rig_file;
  int logs = 0;
  std::vector<std::string> to_fill_in;  // keys of the rig that the recording does not say
  double seconds = 0;
  // Left out: pieces that are short, or in which a joint stands still.
  double seconds_left_out = 0;
  int64_t late_rows = 0, bad_rows = 0;  // out of order, or with a number that is none
  int64_t rows_without_command = 0;     // before the first, or the first after a clock was set back
  int64_t wrong_stamps = 0;  // rows whose stamp fits neither what is before nor behind it
};

// The second pass: out/rig.yaml and a CSV log per piece of `recording`, in constant memory. A row
// is a message with all joints' positions, at its header.stamp; beside them stands the command that
// held then (row_merger.h). A piece ends at a step of more than five rows forward or back, at an
// episode, and at plan.longest_piece_s; every third is held out. `declared`: a rig of the same arm
// whose model, servos and effects are taken over by the joints' names; without it they are marked
// to be filled in (plan.model apart), and `robostress calibrate` names the mark. A folder that
// holds something is refused. FAILED_PRECONDITION where no piece is left.
absl::StatusOr<RecordingRigSummary> WriteRecordingRig(const std::string& recording,
                                                      const RecordingPlan& plan,
                                                      const std::optional<Rig>& declared,
                                                      const std::string& out);

}  // namespace robostress::calibration
