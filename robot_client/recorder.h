#pragma once

#include <atomic>
#include <cstdio>
#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "robot_client/cameras/frame_record.h"
#include "robot_client/control/spsc_ring.h"
#include "robot_client/control/tick_record.h"

namespace robostress {

// Writes every tick and every change of state of a run to a directory:
//
//   ticks.csv      a row per tick; SI units, columns in its header. Empty fields did not apply.
//   samples.csv    a row per complete sample of the arm (200 per second on a Piper), for
//   calibration:
//                  joints [rad, rad/s, Nm], gripper [m]; not there where the arm gave none
//   frames.csv     a row per prediction and camera: which picture the policy was shown (or why none
//                  was), its sequence, stamp [s] and age [ms]; `prediction` as in ticks.csv;
//                  `picture`: the file of it, where pictures are kept. Not there where no
//                  prediction was asked for
//   pictures/      REQUEST_CAMERA.png: what the policy was shown, in its own size
//   events.jsonl   changes of state with their cause, starts and ends of episodes, what the program
//                  notes; flushed line by line
//
// A table's name ends in .partial until Finish: a file without that ending is whole. One
// thread (the recorder's) calls everything.
class Recorder {
 public:
  // Makes the directory. ALREADY_EXISTS when it holds a recording. `axes`: of the ticks and samples
  // that come; each has its columns.
  static absl::StatusOr<std::unique_ptr<Recorder>> Create(const std::string& directory,
                                                          const ArmAxes& axes = {});
  ~Recorder();

  SpscRing<TickRecord>& ring() { return ring_; }
  SpscRing<ArmSnapshot>& samples() { return samples_; }
  SpscRing<FrameRecord>& frames() { return frames_; }

  // Writes what has come. An error names the file; what was written before it stays.
  absl::Status Drain();
  // Drain every 50 ms until `stop`; after the first error, which it returns and calls `failed`
  // with, nothing is written any more.
  absl::Status Run(const std::atomic<bool>& stop,
                   const std::function<void(const absl::Status&)>& failed);
  // Appends an event; `json` is one object.
  absl::Status Event(const std::string& json);
  // The last rows, then the final name.
  absl::Status Finish();

  uint64_t rows() const { return rows_; }
  static std::string Header(const ArmAxes& axes);  // of ticks.csv, without line end
  static std::string Row(const TickRecord& record, int64_t origin_ns);

 private:
  Recorder(std::string directory, const ArmAxes& axes)
      : directory_(std::move(directory)), axes_(axes) {}
  absl::Status NoteChange(const TickRecord& record);
  absl::Status DrainSamples();
  absl::Status DrainFrames();

  const std::string directory_;
  const ArmAxes axes_;
  SpscRing<TickRecord> ring_{1 << 10};
  SpscRing<ArmSnapshot> samples_{1 << 11};  // 10 s of a Piper's
  SpscRing<FrameRecord> frames_{1 << 8};    // with pictures of 640 x 480 up to 236 MB of them
  std::FILE* ticks_ = nullptr;
  std::FILE* samples_file_ = nullptr;
  std::FILE* frames_file_ = nullptr;
  int64_t origin_ns_ = 0;
  uint64_t rows_ = 0;
  ClientState state_ = ClientState::kIdle;
  StateCause cause_ = StateCause::kNone;
};

}  // namespace robostress
