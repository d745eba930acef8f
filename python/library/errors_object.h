#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "absl/status/status.h"
#include "common/joint_errors/joint_chain.h"
#include "python/library/robostress.h"

namespace robostress {

// What act_attached() works in; it belongs to the caller.
struct Attachment {
  const robostress_moment* moment = nullptr;
  robostress_arrays arrays = {};
  const double* asked = nullptr;
  double* record = nullptr;
  size_t rows = 0, row = 0;
};

}  // namespace robostress

struct robostress_errors {
  robostress_errors(const robostress::JointChain& with, bool sticks)
      : chain(with),
        sticks(sticks),
        q(static_cast<size_t>(with.joints())),
        own(9 * static_cast<size_t>(with.joints())),
        moments(static_cast<size_t>(with.joints())) {}

  robostress::JointChain chain;
  bool sticks;                                   // the paper's friction, under the law stick
  std::vector<double> q;                         // of the joints in the sub-step
  std::vector<double> own;                       // of act(): a moment, torques, change
  std::vector<robostress::JointMoment> moments;  // of the motors in it
  bool begun = false;                            // an episode
  bool asked = false;                            // torque() was called in this sub-step
  int64_t sub_steps = 0;                         // of act_attached() in this episode
  robostress::Attachment attached;
};

namespace robostress {

unsigned Reads(const robostress_errors& errors);  // robostress_errors_reads
// The first of `count` values that is not finite is an error, as is none where one is needed.
absl::Status CheckArray(const char* name, const double* values, int count, bool needed);
absl::Status CheckMoment(const robostress_errors& errors, const robostress_moment& moment);
absl::Status CheckBegun(const robostress_errors& errors);
absl::Status Reset(robostress_errors& errors, const robostress_moment& at, const double* holding);
// A sub-step of an episode that has begun, with a checked moment: its torques, then its offsets.
void ApplyErrors(robostress_errors& errors, const robostress_moment& at, const double* asked,
                 double* applied);
void MoveOffsets(robostress_errors& errors, const double* applied, double* change);

}  // namespace robostress
