// The C interface beside the C++ kernels that it wraps: the same bits; and what it says to callers
// who are wrong.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/joint_errors/joint_chain.h"
#include "common/joint_errors/scenarios.h"
#include "common/joint_errors/sub_step.h"
#include "robostress.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

using Vector7d = Eigen::Matrix<double, 7, 1>;
using Matrix7d = Eigen::Matrix<double, 7, 7>;
using Handle = std::unique_ptr<robostress_errors, decltype(&robostress_errors_free)>;

class Library : public ::testing::Test {
 protected:
  static robostress_options Options() {
    robostress_options options;
    options.size = sizeof(options);
    robostress_options_default(&options);
    return options;
  }
  robostress_code New(const char* scenario, int joints, const robostress_options* options,
                      Handle& handle) {
    robostress_errors* made = nullptr;
    const robostress_code code =
        robostress_errors_new(scenario, joints, options, &made, error_, sizeof(error_));
    handle.reset(made);
    return code;
  }
  Handle Make(const char* scenario, int joints = 7, const robostress_options* options = nullptr) {
    Handle handle(nullptr, robostress_errors_free);
    EXPECT_EQ(New(scenario, joints, options, handle), ROBOSTRESS_OK) << error_;
    return handle;
  }
  char error_[400] = "";
};

// An arm in motion, as a simulator would describe it.
struct Moment {
  explicit Moment(std::mt19937& random, int joints = 7) {
    std::normal_distribution<double> normal;
    const auto fill = [&](std::vector<double>& values, size_t count, double scale) {
      for (size_t i = 0; i < count; ++i) values.push_back(scale * normal(random));
    };
    const auto n = static_cast<size_t>(joints);
    fill(q, n, 1);
    fill(dq, n, 0.3);
    fill(ddq, n, 2);
    fill(temperature, n, 30);
    fill(gravity, n, 10);
    fill(payload_gravity, n, 3);
    fill(payload_inertia, n, 0.2);
    fill(tilt, 2 * n, 2);
    fill(other, n, 8);
    fill(asked, n, 40);
    low.assign(n, -60);
    high.assign(n, 60);
    const Eigen::MatrixXd half = Eigen::MatrixXd::NullaryExpr(
        joints, joints, [&](Eigen::Index, Eigen::Index) { return 0.3 * normal(random); });
    const Eigen::MatrixXd M = half * half.transpose() + Eigen::MatrixXd::Identity(joints, joints);
    mass.assign(M.data(), M.data() + M.size());
  }
  robostress_moment At(int sub_step) const {
    robostress_moment m = {};
    m.size = sizeof(m);
    m.time = 0.002 * sub_step;
    m.step = 0.002;
    m.q = q.data();
    m.dq = dq.data();
    m.ddq = ddq.data();
    m.temperature = temperature.data();
    m.gravity = gravity.data();
    m.payload_gravity = payload_gravity.data();
    m.payload_inertia = payload_inertia.data();
    m.tilt_gravity = tilt.data();
    m.mass_matrix = mass.data();
    m.other_torque = other.data();
    m.torque_low = low.data();
    m.torque_high = high.data();
    return m;
  }
  std::vector<double> q, dq, ddq, temperature, gravity, payload_gravity, payload_inertia, tilt,
      mass, other, low, high, asked;
};

// The arm of a Moment as PandaSim's chain sees its own.
struct Plant {
  using Inverse = Matrix7d;
  const Moment& moment;
  double rest = 0, h = 0.002;
  static Vector7d Vector(const std::vector<double>& values) { return Vector7d(values.data()); }
  Vector7d Limited(const Vector7d& torque) const {
    return torque.cwiseMax(Vector(moment.low)).cwiseMin(Vector(moment.high));
  }
  Vector7d Net(const Vector7d& torque) const { return torque + Vector(moment.other); }
  Matrix7d MassMatrix() const { return Matrix7d(moment.mass.data()); }
  Vector7d Velocities() const { return Vector(moment.dq); }
};

std::vector<JointMoment> Describe(const JointChain& chain, const Moment& from, int sub_step) {
  std::vector<JointMoment> moments(7);
  for (size_t i = 0; i < 7; ++i) {
    const int other = chain.coupled(static_cast<int>(i));
    moments[i] = {.t = 0.002 * sub_step,
                  .h = 0.002,
                  .q = chain.MotorAngle(static_cast<int>(i), from.q[i]),
                  .dq = from.dq[i],
                  .gravity = from.gravity[i],
                  .payload_gravity = from.payload_gravity[i],
                  .payload_inertia = from.payload_inertia[i],
                  .tilt_gravity = {from.tilt[2 * i], from.tilt[2 * i + 1]},
                  .temperature = from.temperature[i]};
    if (other < 0) continue;
    const auto k = static_cast<size_t>(other);
    moments[i].coupled_q = from.q[k];
    moments[i].coupled_dq = from.dq[k];
    moments[i].coupled_ddq = from.ddq[k];
  }
  return moments;
}

// 200 sub-steps of any motion: torques, offsets and readings of both, bit by bit.
void ExpectEqual(robostress_errors* errors, JointChain chain, const std::string& what) {
  std::mt19937 random(7);
  char error[200] = "";
  const Moment start(random);
  const robostress_moment begin = start.At(0);
  ASSERT_EQ(robostress_errors_reset(errors, &begin, start.gravity.data(), error, sizeof(error)),
            ROBOSTRESS_OK)
      << what << ": " << error;
  std::vector<JointMoment> moments = Describe(chain, start, 0);
  for (size_t i = 0; i < 7; ++i) {
    moments[i].q = start.q[i];
    moments[i].drive = start.gravity[i];
  }
  chain.Reset(moments);
  for (int sub_step = 0; sub_step < 200; ++sub_step) {
    if (sub_step % 25 == 0) {
      const bool held = sub_step >= 50;
      robostress_errors_begin_control_step(errors, sub_step / 25, held);
      chain.BeginControlStep(sub_step / 25, held);
    }
    const Moment now(random);
    const robostress_moment moment = now.At(sub_step);
    std::array<double, 7> applied, change, offset, reading, rate, at_once, moved_at_once;
    robostress_errors* twin = nullptr;
    ASSERT_EQ(robostress_errors_copy(errors, &twin, nullptr, 0), ROBOSTRESS_OK);
    const Handle freed(twin, robostress_errors_free);
    ASSERT_EQ(robostress_errors_sub_step(twin, &moment, now.asked.data(), at_once.data(),
                                         moved_at_once.data(), error, sizeof(error)),
              ROBOSTRESS_OK);
    ASSERT_EQ(robostress_errors_torque(errors, &moment, now.asked.data(), applied.data(), error,
                                       sizeof(error)),
              ROBOSTRESS_OK)
        << what << ": " << error;
    ASSERT_EQ(robostress_errors_offset_change(errors, applied.data(), change.data(), error,
                                              sizeof(error)),
              ROBOSTRESS_OK);
    ASSERT_EQ(at_once, applied);
    ASSERT_EQ(moved_at_once, change);
    robostress_errors_offset(errors, offset.data());
    robostress_errors_reading(errors, now.q.data(), now.dq.data(), reading.data(), rate.data());

    chain.BeginSubStep(0.002);
    moments = Describe(chain, now, sub_step);
    const Vector7d none = Vector7d::Zero();
    const Vector7d torque =
        SubStepTorque(chain, absl::MakeSpan(moments), Vector7d(now.asked.data()), none, Plant{now});
    Vector7d moved = Vector7d::Zero();
    for (JointMoment& m : moments) m.q += m.h * m.dq;
    chain.MoveErrors(now.q, {torque.data(), 7}, 0.002, {moved.data(), 7});
    chain.MoveEffects(moments, {moved.data(), 7});
    for (int i = 0; i < 7; ++i) {
      const auto j = static_cast<size_t>(i);
      ASSERT_EQ(applied[j], torque[i]) << what << ", sub-step " << sub_step << ", joint " << i;
      ASSERT_EQ(change[j], moved[i]) << what << ", sub-step " << sub_step << ", joint " << i;
      ASSERT_EQ(offset[j], chain.offset(i));
      ASSERT_EQ(reading[j], chain.Reading(i, now.q[j]));
      ASSERT_EQ(rate[j], chain.ReadingSlope(i, now.q[j]) * now.dq[j]);
    }
  }
}

TEST_F(Library, GivesTheBitsOfTheKernelsInEveryScenario) {
  for (const std::string& name : ScenarioNames()) {
    for (const char* law : {"sgn", "tanh", "stick"}) {
      robostress_options options = Options();
      options.friction_law = law;
      options.severity = 4;
      options.horizon = 6;
      options.offset_start = "equilibrium";
      options.gravity_sign = "payload";
      JointErrorOptions laws;
      laws.friction_law = law == std::string("sgn")    ? FrictionLaw::kSgn
                          : law == std::string("tanh") ? FrictionLaw::kTanh
                                                       : FrictionLaw::kStick;
      laws.offset_start = OffsetStart::kEquilibrium;
      laws.gravity_sign = GravitySign::kPayload;
      JointChain chain(7, laws);
      chain.SetScenario(*MakeScenario(name, 4), 6);
      ExpectEqual(Make(name.c_str(), 7, &options).get(), chain, absl::StrCat(name, ", ", law));
    }
  }
}

TEST_F(Library, GivesTheBitsOfEveryEffect) {
  for (const EffectInfo& effect : EffectLibrary()) {
    if (effect.of_position) continue;  // SaysWhatIsWrong
    std::vector<double> values;
    for (const EffectParameter& parameter : effect.parameters) {
      const double start = parameter.starts.empty() ? 0.1 : parameter.starts.front();
      values.push_back(start > 0 ? start : 0.1);
    }
    const int coupled = effect.coupled ? 1 : -1;
    JointChain chain(7);
    chain.Add(3, effect, values, coupled);
    const Handle errors = Make("clean");
    ASSERT_EQ(robostress_errors_add_effect(errors.get(), 3, effect.type.c_str(), values.data(),
                                           values.size(), coupled, error_, sizeof(error_)),
              ROBOSTRESS_OK)
        << effect.type << ": " << error_;
    ExpectEqual(errors.get(), chain, effect.type);
  }
}

TEST_F(Library, ListsTheScenarios) {
  std::vector<std::string> names;
  int deployed = 0;
  for (size_t i = 0; i < robostress_scenario_count(); ++i) {
    names.push_back(robostress_scenario_name(i));
    EXPECT_NE(robostress_scenario_title(i), std::string());
    deployed += robostress_scenario_deployed(i);
  }
  EXPECT_EQ(names, ScenarioNames());
  EXPECT_EQ(deployed, 7);
  EXPECT_EQ(robostress_scenario_name(names.size()), nullptr);
}

TEST_F(Library, ACopyGoesOnAsItsOriginal) {
  std::mt19937 random(3);
  const Moment start(random), next(random);
  const robostress_moment first = start.At(0), second = next.At(1);
  const Handle errors = Make("aged_transmission");
  std::array<double, 7> before, after, again, applied;
  const auto step = [&](robostress_errors* of, std::array<double, 7>& change) {
    EXPECT_EQ(robostress_errors_torque(of, &second, next.asked.data(), applied.data(), nullptr, 0),
              ROBOSTRESS_OK);
    EXPECT_EQ(robostress_errors_offset_change(of, applied.data(), change.data(), nullptr, 0),
              ROBOSTRESS_OK);
  };
  ASSERT_EQ(robostress_errors_reset(errors.get(), &first, nullptr, error_, sizeof(error_)),
            ROBOSTRESS_OK);
  step(errors.get(), before);
  robostress_errors* saved = nullptr;
  ASSERT_EQ(robostress_errors_copy(errors.get(), &saved, error_, sizeof(error_)), ROBOSTRESS_OK);
  const Handle copy(saved, robostress_errors_free);
  step(errors.get(), after);
  ASSERT_NE(before, after) << "it remembers";
  ASSERT_EQ(robostress_errors_restore(errors.get(), copy.get(), error_, sizeof(error_)),
            ROBOSTRESS_OK);
  step(errors.get(), again);
  EXPECT_EQ(again, after);
  step(copy.get(), again);
  EXPECT_EQ(again, after);
}

TEST_F(Library, SaysWhatIsWrong) {
  Handle none(nullptr, robostress_errors_free);
  const auto refuses = [&](robostress_code code, robostress_code expected, const char* words) {
    EXPECT_EQ(code, expected) << words;
    EXPECT_THAT(error_, HasSubstr(words));
    EXPECT_EQ(none, nullptr);
  };
  const auto bad = ROBOSTRESS_INVALID_ARGUMENT;
  robostress_options options = Options();
  refuses(New("heavy", 7, nullptr, none), ROBOSTRESS_NOT_FOUND, "known: clean, heavy_payload");
  refuses(New(nullptr, 7, nullptr, none), bad, "scenario is NULL");
  refuses(New("clean", 0, nullptr, none), bad, "joints is 0, must be 1 to 64");
  refuses(New("heavy_payload", 6, nullptr, none), bad,
          "the arm has 6; give its own as options.nominal");
  options.severity = 6;
  refuses(New("heavy_payload", 7, &options, none), bad, "outside 1 (mild) .. 5 (full)");
  options = Options();
  options.friction_law = "glue";
  refuses(New("clean", 7, &options, none), bad, "friction_law is 'glue', must be one of sgn, tanh");
  options = Options();
  options.horizon = 0;
  refuses(New("clean", 7, &options, none), bad, "horizon is 0");
  options = Options();
  options.tanh_width = std::nan("");
  refuses(New("clean", 7, &options, none), bad, "tanh_width is nan");
  for (const double width : {-0.01, std::numeric_limits<double>::infinity()}) {
    options.tanh_width = width;
    refuses(New("clean", 7, &options, none), bad, "tanh_width is ");
  }
  options = Options();
  options.size += 8;
  refuses(New("clean", 7, &options, none), bad, "options.size is");
  refuses(New("/no/such/file.yaml", 7, nullptr, none), ROBOSTRESS_NOT_FOUND, "/no/such/file.yaml");
  EXPECT_EQ(robostress_errors_new("clean", 7, nullptr, nullptr, error_, sizeof(error_)), bad);

  const Handle errors = Make("clean", 3);
  const double value = 0.1, negative = -0.1;
  const auto add = [&](int joint, const char* type, const double* values, size_t count,
                       int coupled) {
    return robostress_errors_add_effect(errors.get(), joint, type, values, count, coupled, error_,
                                        sizeof(error_));
  };
  refuses(add(3, "backlash", &value, 1, -1), bad, "joint is 3, must be 0 to 2");
  refuses(add(0, "grease", &value, 1, -1), ROBOSTRESS_NOT_FOUND, "backlash");
  refuses(add(0, "backlash", &value, 0, -1), bad,
          "values has 0 numbers, backlash takes 1: B [rad]");
  refuses(add(0, "backlash", &negative, 1, -1), bad, "backlash.B is -0.1 rad");
  refuses(add(0, "backlash", &value, 1, 1), bad, "coupled is 1, must be -1");
  refuses(add(0, "rate_limit", &value, 1, -1), bad,
          "rate_limit limits the position command of a servo [rad/s], these errors bend torques");
  const double wave[] = {1, 0, 1e-310};
  refuses(add(0, "position_periodic_torque", wave, 3, -1), bad,
          "position_periodic_torque.wavelength is 1e-310 rad, must be 1e-09 to 1e+12");

  std::mt19937 random(1);
  Moment arm(random, 3);
  robostress_moment moment = arm.At(0);
  std::array<double, 3> applied;
  const auto torque = [&](const Handle& of) {
    return robostress_errors_torque(of.get(), &moment, arm.asked.data(), applied.data(), error_,
                                    sizeof(error_));
  };
  refuses(torque(errors), ROBOSTRESS_WRONG_ORDER, "robostress_errors_reset first");
  ASSERT_EQ(robostress_errors_reset(errors.get(), &moment, nullptr, error_, sizeof(error_)),
            ROBOSTRESS_OK);
  refuses(robostress_errors_offset_change(errors.get(), arm.asked.data(), applied.data(), error_,
                                          sizeof(error_)),
          ROBOSTRESS_WRONG_ORDER, "robostress_errors_torque before each call");
  arm.dq[1] = std::numeric_limits<double>::infinity();
  refuses(torque(errors), bad, "dq[1] is inf, must be finite");
  arm.dq[1] = 0;
  moment.step = 0;
  refuses(torque(errors), bad, "step is 0 s");
  moment = arm.At(0);
  moment.size = 4;
  refuses(torque(errors), bad, "moment.size is 4");
  moment = arm.At(0);
  arm.low[2] = 1;
  refuses(torque(errors), bad, "torque_low[2] is 1");
  refuses(add(0, "asymmetric_coulomb", &value, 9, -1), bad, "asymmetric_coulomb takes");
}

TEST_F(Library, AsksForWhatItReads) {
  robostress_options options = Options();
  options.friction_law = "stick";
  const Handle sticks = Make("aged_transmission", 7, &options), clean = Make("clean");
  EXPECT_TRUE(robostress_errors_reads(sticks.get()) & ROBOSTRESS_READS_MASSES);
  EXPECT_EQ(robostress_errors_reads(clean.get()), 0u);
  std::mt19937 random(1);
  const Moment arm(random);
  robostress_moment moment = arm.At(0);
  moment.mass_matrix = nullptr;
  EXPECT_EQ(robostress_errors_reset(sticks.get(), &moment, nullptr, error_, sizeof(error_)),
            ROBOSTRESS_INVALID_ARGUMENT);
  EXPECT_THAT(error_, HasSubstr("mass_matrix is NULL, and these errors read it"));
}

TEST_F(Library, CutsMessagesThatDoNotFit) {
  char small[8];
  std::memset(small, 'x', sizeof(small));
  robostress_errors* none = nullptr;
  EXPECT_EQ(robostress_errors_new("nope", 7, nullptr, &none, small, sizeof(small)),
            ROBOSTRESS_NOT_FOUND);
  EXPECT_EQ(std::string(small), "unknown");
  EXPECT_EQ(robostress_errors_new("nope", 7, nullptr, &none, small, 0), ROBOSTRESS_NOT_FOUND);
  EXPECT_EQ(robostress_errors_new("nope", 7, nullptr, &none, nullptr, 9), ROBOSTRESS_NOT_FOUND);
}

TEST_F(Library, ObjectsOfDifferentThreadsKnowNothingOfEachOther) {
  JointChain chain(7);
  chain.SetScenario(*MakeScenario("aged_joint_uniform", 5), 300);
  std::vector<std::thread> threads;
  for (int i = 0; i < 4; ++i) {
    threads.emplace_back([&chain] {
      robostress_errors* errors = nullptr;
      ASSERT_EQ(robostress_errors_new("aged_joint_uniform", 7, nullptr, &errors, nullptr, 0),
                ROBOSTRESS_OK);
      ExpectEqual(errors, chain, "a thread");
      robostress_errors_free(errors);
    });
  }
  for (std::thread& thread : threads) thread.join();
}

// Any sequence of calls with any numbers: a code and a sentence, never a crash, and only finite
// torques where it says that all is well.
TEST_F(Library, SurvivesCallsInAnyOrder) {
  std::mt19937 random(11);
  const auto draw = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  const double odd[] = {0,     -1, 1e300, std::nan(""), std::numeric_limits<double>::infinity(),
                        1e-300};
  const std::vector<std::string> names = ScenarioNames();
  for (int round = 0; round < 300; ++round) {
    const int joints = draw(3) == 0 ? 1 + draw(9) : 7;
    robostress_options options = Options();
    options.severity = draw(7);
    options.friction_law = draw(2) == 0 ? "stick" : "sgn";
    Handle errors(nullptr, robostress_errors_free);
    New(draw(2) == 0 ? "clean" : names[static_cast<size_t>(draw(14))].c_str(), joints, &options,
        errors);
    for (int call = 0; call < 40; ++call) {
      Moment arm(random, joints);
      if (draw(4) == 0) arm.q[static_cast<size_t>(draw(joints))] = odd[draw(6)];
      if (draw(4) == 0) arm.mass[static_cast<size_t>(draw(joints * joints))] = odd[draw(6)];
      robostress_moment moment = arm.At(call);
      if (draw(6) == 0) moment.step = odd[draw(6)];
      if (draw(6) == 0) moment.gravity = nullptr;
      if (draw(6) == 0) moment.other_torque = nullptr;
      if (draw(6) == 0) moment.mass_matrix = nullptr;
      std::vector<double> out(static_cast<size_t>(joints));
      switch (draw(5)) {
        case 0:
          robostress_errors_reset(errors.get(), &moment, nullptr, error_, sizeof(error_));
          break;
        case 1:
          robostress_errors_begin_control_step(errors.get(), draw(1000) - 500, draw(2));
          break;
        case 2: {
          const EffectInfo& effect = EffectLibrary()[static_cast<size_t>(draw(20))];
          std::vector<double> values(effect.parameters.size(), draw(2) == 0 ? 0.2 : odd[draw(6)]);
          robostress_errors_add_effect(errors.get(), draw(joints + 1) - 1, effect.type.c_str(),
                                       values.data(), values.size(), draw(3) - 1, error_,
                                       sizeof(error_));
          break;
        }
        case 3:
          robostress_errors_torque(errors.get(), &moment, arm.asked.data(), out.data(), error_,
                                   sizeof(error_));
          break;
        default:
          robostress_errors_offset_change(errors.get(), arm.asked.data(), out.data(), error_,
                                          sizeof(error_));
      }
    }
  }
}

TEST_F(Library, HasNoFunctionOfCPythonWhereNoneHasLoadedIt) {
  EXPECT_EQ(robostress_cpython_sub_step(), nullptr);
}

#ifdef LIBROBOSTRESS
TEST(LibraryFile, LinksGlibcAloneAndShowsOnlyItsInterface) {
  const auto [needed, code] = RunProgram("objdump", "-p " LIBROBOSTRESS " | grep NEEDED");
  ASSERT_EQ(code, 0) << needed;
  EXPECT_THAT(needed, HasSubstr("libc.so.6"));
  for (const char* foreign : {"stdc++", "absl", "yaml", "png", "ssl", "crypto", "spdlog", "gcc_s"})
    EXPECT_THAT(needed, ::testing::Not(HasSubstr(foreign)));
  const auto [symbols, listed] = RunProgram(
      "nm", "-D --defined-only " LIBROBOSTRESS " | grep -v ' robostress_' | grep -v ' A '");
  EXPECT_EQ(symbols, "") << "every symbol is of the interface";
}
#endif

}  // namespace
}  // namespace robostress
