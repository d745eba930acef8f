// librobostress.so's C interface: an input is a program of calls, two bytes each and their numbers.
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <vector>

#include "robostress.h"
#include "tests/fuzz/fuzz_check.h"

namespace {

using robostress::FuzzCheck;
constexpr size_t kJoints = 7, kRows = 5, kAction = 7;

class Input {
 public:
  Input(const uint8_t* data, size_t size) : at_(data), end_(data + size) {}
  bool empty() const { return at_ == end_; }
  uint8_t Byte() { return empty() ? 0 : *at_++; }
  double Number() {
    const uint8_t kind = Byte();
    constexpr double kOdd[] = {0, -1, 1e300, 1e-300, 1e12};
    if (kind < 5) return kOdd[kind];
    if (kind == 5) return std::numeric_limits<double>::quiet_NaN();
    if (kind == 6) return -std::numeric_limits<double>::infinity();
    return (kind - 128) / 16.0;
  }
  template <class Values>
  void Fill(Values& values) {
    // Mostly plain, so that programs come far.
    for (auto& v : values) v = 0.25;
    for (int odd = Byte() % 4; odd > 0; --odd) {
      using Value = std::remove_reference_t<decltype(values[0])>;
      values[Byte() % values.size()] = static_cast<Value>(Number());
    }
  }

 private:
  const uint8_t *at_, *end_;
};

void CheckCode(robostress_code code, const char* error) {
  if (code == ROBOSTRESS_OK) return;
  FuzzCheck(code != ROBOSTRESS_INTERNAL, std::string("a fault of its own: ") + error);
  FuzzCheck(std::strlen(error) > 10, "a failure without a sentence");
}

template <class Values>
bool Finite(const Values& values) {
  for (const auto v : values)
    if (!std::isfinite(v)) return false;
  return true;
}

struct Errors {
  std::unique_ptr<robostress_errors, void (*)(robostress_errors*)> held{nullptr,
                                                                        robostress_errors_free};
  char error[256] = "";

  void New(Input& input) {
    robostress_options options = {};
    options.size = sizeof options;
    robostress_options_default(&options);
    options.severity = input.Byte() % 7;
    options.horizon = input.Byte();
    constexpr const char* kLaws[] = {"sgn", "tanh", "stick", ""};
    options.friction_law = kLaws[input.Byte() % 4];
    options.tanh_width = input.Number();
    const char* scenario = robostress_scenario_name(input.Byte() % 15);
    robostress_errors* made = nullptr;
    CheckCode(robostress_errors_new(scenario == nullptr ? "none" : scenario, kJoints, &options,
                                    &made, error, sizeof error),
              error);
    if (made != nullptr) held.reset(made);
  }

  void Call(int call, Input& input) {
    std::array<double, kJoints> q, dq, gravity, payload, inertia, asked, applied{}, change{};
    std::array<double, 2 * kJoints> tilt;
    std::array<double, kJoints * kJoints> mass;
    input.Fill(q), input.Fill(dq), input.Fill(gravity), input.Fill(payload), input.Fill(inertia);
    input.Fill(asked), input.Fill(tilt), input.Fill(mass);
    for (size_t i = 0; i < kJoints; ++i) mass[i * (kJoints + 1)] += 2;
    robostress_moment moment = {};
    moment.size = sizeof moment;
    moment.step = 0.002;
    moment.q = q.data(), moment.dq = dq.data(), moment.gravity = gravity.data();
    moment.payload_gravity = payload.data(), moment.payload_inertia = inertia.data();
    moment.tilt_gravity = tilt.data(), moment.mass_matrix = mass.data();
    moment.other_torque = gravity.data(), moment.ddq = dq.data();
    if (call == 0) {
      CheckCode(robostress_errors_reset(held.get(), &moment, nullptr, error, sizeof error), error);
    } else if (call == 1) {
      robostress_errors_begin_control_step(held.get(), input.Byte() - 5, input.Byte() % 2);
    } else if (call == 2) {
      const auto code = robostress_errors_sub_step(
          held.get(), &moment, asked.data(), applied.data(), change.data(), error, sizeof error);
      CheckCode(code, error);
      FuzzCheck(code != ROBOSTRESS_OK || (Finite(applied) && Finite(change)),
                "a torque that is no number");
    } else if (call == 3) {
      constexpr const char* kEffects[] = {"viscous", "gravity_offset", "backlash", "nothing"};
      CheckCode(robostress_errors_add_effect(held.get(), input.Byte() % 9 - 1,
                                             kEffects[input.Byte() % 4], q.data(), input.Byte() % 4,
                                             input.Byte() % 9 - 1, error, sizeof error),
                error);
    } else {
      robostress_errors* copy = nullptr;
      CheckCode(robostress_errors_copy(held.get(), &copy, error, sizeof error), error);
      std::array<double, kJoints> other{}, more{};
      const auto first = robostress_errors_sub_step(
          held.get(), &moment, asked.data(), applied.data(), change.data(), error, sizeof error);
      const auto second = robostress_errors_sub_step(copy, &moment, asked.data(), other.data(),
                                                     more.data(), error, sizeof error);
      FuzzCheck(first == second && applied == other && change == more,
                "a copy that goes on otherwise");
      robostress_errors_free(copy);
    }
  }
};

struct Compensator {
  std::unique_ptr<robostress_compensator, void (*)(robostress_compensator*)> held{
      nullptr, robostress_compensator_free};
  char error[256] = "";

  void New(Input& input) {
    constexpr const char* kMethods[] = {"base",   "gain",          "direct",
                                        "smooth", "ours_integral", "ours_following",
                                        "ours",   "nobody",        "ours_following_step"};
    constexpr const char* kOverrides[] = {"goal_memory=0.5", "calibrator_memory=50",
                                          "gain=2",          "following_gain=9",
                                          "rubbish",         "integral_limit=nan"};
    const char* override = kOverrides[input.Byte() % 6];
    robostress_compensator* made = nullptr;
    CheckCode(robostress_compensator_new(kMethods[input.Byte() % 9], &override, input.Byte() % 2,
                                         nullptr, &made, error, sizeof error),
              error);
    if (made != nullptr) held.reset(made);
  }

  void Call(int call, Input& input) {
    std::array<float, kRows * kAction> actions, sent{};
    std::array<double, 3 * (kRows + 1)> position;
    std::array<double, 4 * (kRows + 1)> orientation{};
    input.Fill(actions), input.Fill(position);
    for (size_t i = 0; i <= kRows; ++i) orientation[4 * i] = 1;
    if (input.Byte() % 8 == 0) input.Fill(orientation);
    robostress_executed executed = {};
    executed.size = sizeof executed;
    executed.steps = call == 2 ? 1 : kRows;
    executed.position = position.data(), executed.orientation = orientation.data();
    executed.policy_command = executed.sent_command = actions.data();
    if (call == 0) {
      robostress_compensator_start_episode(held.get());
    } else if (call == 1) {
      const auto code = robostress_compensator_correct(held.get(), actions.data(), kRows,
                                                       sent.data(), error, sizeof error);
      CheckCode(code, error);
      FuzzCheck(code != ROBOSTRESS_OK || Finite(sent), "a command that is no number");
    } else if (call == 2) {
      const auto code =
          robostress_compensator_next(held.get(), input.Byte() % 2 == 0 ? nullptr : &executed,
                                      sent.data(), error, sizeof error);
      CheckCode(code, error);
      FuzzCheck(code != ROBOSTRESS_OK || Finite(sent), "a command that is no number");
    } else {
      CheckCode(robostress_compensator_executed(held.get(), &executed, error, sizeof error), error);
      std::array<double, kAction - 1> correction{};
      robostress_compensator_correction(held.get(), correction.data());
      FuzzCheck(Finite(correction), "a correction that is no number");
    }
  }
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  Input input(data, size);
  Errors errors;
  Compensator compensator;
  while (!input.empty()) {
    const uint8_t op = input.Byte();
    if (op % 12 == 0 || errors.held == nullptr) errors.New(input);
    if (op % 12 == 1 || compensator.held == nullptr) compensator.New(input);
    if (op % 12 >= 2 && op % 12 < 7 && errors.held != nullptr) errors.Call(op % 12 - 2, input);
    if (op % 12 >= 7 && compensator.held != nullptr) compensator.Call(op % 12 % 4, input);
  }
  return 0;
}
