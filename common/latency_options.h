#pragma once

namespace robostress {

// What an arm does while the next prediction is on its way, and how it enters it.
enum class LateChunks {
  kWaiting,    // plays execute_steps rows, asks, and holds still until the answer is there
  kSwitch,     // plays on, and enters the answer at the row that is due
  kCrossfade,  // the same; the difference to what would have been played fades out
  kRtc,  // as switch; the policy is told what is left of the running chunk and goes on from it
};

// Answers that take time, in a simulated clock: an answer to step k's observation is there at step
// k + ceil(ms / control period).
struct LatencyOptions {
  int ms = 0;  // from an observation to its answer [ms]; 0: none, and nothing below acts
  // Not the crossfade of robot_client: that of absolute targets is a fade of places, that of
  // displacements mixes two plans (docs/results/late-answers.md).
  LateChunks mode = LateChunks::kSwitch;
  // As robot_client plays (PlayerOptions).
  int late_steps = 10;  // rows more that are played while the next chunk is late
  int fade_steps = 4;   // control steps over which a late chunk's offset fades out; crossfade
  // Steps that the fade moved by more are masked in feedback [command units].
  double moved_bound = 0.1;
  int guide_rows = 0;       // rtc: rows after those that will have been played that guide; 0: all
  bool smoothness = false;  // rows say it at latency 0 too

  bool late() const { return ms > 0; }
  // Whether a unit says it; also whether its rows hold measures of smoothness.
  bool used() const { return late() || smoothness; }

  template <class V>
  void Visit(V& v) {
    v.Field("ms", ms, "from an observation to its answer [ms]");
    v.Choice("mode", mode,
             {{"waiting", LateChunks::kWaiting},
              {"switch", LateChunks::kSwitch},
              {"crossfade", LateChunks::kCrossfade},
              {"rtc", LateChunks::kRtc}},
             "what the arm does meanwhile: holds still; plays on and enters the chunk at the row "
             "that is due, at once, faded, or with a chunk that was made to go on from it");
    v.Field("late_steps", late_steps, "rows more that are played while the next chunk is late");
    v.Field("fade_steps", fade_steps, "control steps over which a late chunk's offset fades out");
    v.Field("moved_bound", moved_bound,
            "steps that the fade moved by more are masked in feedback [command units]");
    v.Field("guide_rows", guide_rows,
            "rtc: rows beyond those that will have been played that guide the next chunk; 0: all");
    v.Field("smoothness", smoothness, "rows hold jerk and jumps at latency 0 too");
  }
};

}  // namespace robostress
