// The reader of CAN frames in datagrams, and the protocol above it.
#include <vector>

#include "robot_client/can/udp_codec.h"
#include "robot_client/piper/arm_state.h"
#include "robot_client/piper/command_guard.h"
#include "robot_client/piper/protocol.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  CanFrame frame;
  if (!DecodeUdpCan({data, size}, frame)) return 0;
  FuzzCheck(frame.id <= kMaxCanId && frame.size <= 8, "a frame that is no CAN 2.0 frame");
  for (int i = frame.size; i < 8; ++i) FuzzCheck(frame.data[i] == 0, "bytes beyond the length");
  uint8_t datagram[kUdpCanFrameBytes];
  CanFrame back;
  FuzzCheck(DecodeUdpCan({datagram, EncodeUdpCan(frame, 0, datagram)}, back) && back == frame,
            "a frame that does not come back");
  // What is read of a command is what is written of it, so that nothing unseen passes the guard.
  if (piper::CheckMaySend(frame, piper::Consent::kMotion).ok()) {
    const auto stop = piper::DecodeStop(frame);
    FuzzCheck(!stop || *stop == piper::Stop::kQuick, "a stop that drops the arm");
    const auto power = piper::DecodeMotorPower(frame);
    FuzzCheck(!power || power->enable, "power off without consent");
  }
  piper::ArmState state(3'000'000);
  state.Take({frame, 0});
  FuzzCheck(state.Snapshot(0).sequence == 0, "a sample from one frame");
  return 0;
}
