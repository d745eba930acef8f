#include "robot_client/teach/key_input.h"

namespace robostress {
namespace {

constexpr char kEscape = '\x1b';
constexpr int kGripper = 6;  // behind x, y, z and the three turns

struct MotionKey {
  char key;
  int axis;  // x, y, z, turns about them, gripper
  double share;
};
constexpr MotionKey kMotionKeys[] = {
    {'w', 0, 1},  {'s', 0, -1}, {'a', 1, 1},        {'d', 1, -1},       {'r', 2, 1},
    {'f', 2, -1}, {'u', 3, 1},  {'o', 3, -1},       {'i', 4, 1},        {'k', 4, -1},
    {'l', 5, -1}, {'j', 5, 1},  {'g', kGripper, 1}, {'h', kGripper, -1}};

}  // namespace

const char kKeyHelp[] =
    "Keys, while the arm follows them; a key that is let go stops\n"
    "  w s   forwards, back (also the arrows)   a d   left, right    r f   up, down\n"
    "  i k   pitch      j l   yaw      u o   roll      g h   open, close the gripper\n"
    "  m     joints instead of the tool, and back; 1 to 6 choose a joint, w s move it\n"
    "  R     record     S     success  F     failure   X     discard\n"
    "  Enter or Esc hold, and orders are lines again; any other key stops what moves\n";

void KeyInput::Hold(int axis, double share) {
  JogInput input;
  input.stamp_ns = clock_->now_ns();
  input.by_joint = by_joint_;
  input.joint = joint_;
  if (axis == kGripper) {
    input.gripper = share;
    input.by_joint = false;
  } else if (!by_joint_ || axis == 0) {
    input.tool[axis] = share;
  }
  input_.Store(input);
}

void KeyInput::Reset() { input_.Store({}); }

void KeyInput::End() {
  JogInput input;
  input.gone = true;
  input_.Store(input);
}

void KeyInput::Key(char key, std::deque<OperatorOrder>* orders) {
  for (const MotionKey& motion : kMotionKeys) {
    if (motion.key == key) return Hold(motion.axis, motion.share);
  }
  Reset();
  switch (key) {
    case 'm':
      by_joint_ = !by_joint_;
      return;
    case 'R':
      orders->push_back({OperatorCommand::kRecord});
      return;
    case 'S':
      orders->push_back({OperatorCommand::kSuccess});
      return;
    case 'F':
      orders->push_back({OperatorCommand::kFailure});
      return;
    case 'X':
      orders->push_back({OperatorCommand::kDiscard});
      return;
    case '\n':
    case '\r':
    case kEscape:
      orders->push_back({OperatorCommand::kHold});
      return;
    default:
      if (key >= '1' && key <= '6') joint_ = key - '1';
  }
}

void KeyInput::Take(std::string_view bytes, std::deque<OperatorOrder>* orders) {
  for (size_t i = 0; i < bytes.size(); ++i) {
    if (bytes[i] != kEscape || i + 1 >= bytes.size() ||
        (bytes[i + 1] != '[' && bytes[i + 1] != 'O')) {
      Key(bytes[i], orders);
      continue;
    }
    // ESC [ parameters letter: an arrow, or a key that has no meaning here.
    for (i += 2; i < bytes.size() && !(bytes[i] >= '@' && bytes[i] <= '~'); ++i) {
    }
    constexpr std::string_view kArrows = "ABDC", kAs = "wsad";
    const size_t arrow = i < bytes.size() ? kArrows.find(bytes[i]) : std::string_view::npos;
    Key(arrow == std::string_view::npos ? ' ' : kAs[arrow], orders);
  }
}

}  // namespace robostress
