#pragma once

#include <deque>
#include <string_view>

#include "common/clock.h"
#include "robot_client/operator_console.h"
#include "robot_client/snapshot_cell.h"
#include "robot_client/teach/jog_target.h"

namespace robostress {

extern const char kKeyHelp[];

// Keys of a raw terminal as a jog. A key counts as held for as long as its repetitions come (the
// dead man of JogTarget); of two the later one counts. Enter and Escape hold, every key that has no
// meaning stops what moves. Console's thread; JogTarget reads `input`.
class KeyInput : public KeySink {
 public:
  explicit KeyInput(const Clock* clock) : clock_(clock) {}

  // The keys of `bytes`; what they order, in order. Arrows come as ESC [ A .. D.
  void Take(std::string_view bytes, std::deque<OperatorOrder>* orders) override;
  void End() override;  // the terminal is gone
  void Reset();         // nothing is held; a new motion begins

  const SnapshotCell<JogInput>& input() const { return input_; }
  bool by_joint() const { return by_joint_; }

 private:
  void Key(char key, std::deque<OperatorOrder>* orders);
  void Hold(int axis, double share);

  const Clock* const clock_;
  SnapshotCell<JogInput> input_;
  bool by_joint_ = false;
  int joint_ = 0;
};

}  // namespace robostress
