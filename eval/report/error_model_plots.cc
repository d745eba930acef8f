#include "eval/report/error_model_plots.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "common/joint_errors/effects/backlash.h"
#include "common/joint_errors/effects/compliance.h"
#include "common/joint_errors/effects/friction.h"
#include "common/joint_errors/joint_chain.h"
#include "common/joint_errors/stick_friction.h"
#include "common/svg_plot.h"

namespace robostress {
namespace {

constexpr double kStep = 0.002;  // [s]
constexpr int kSubSteps = 25;    // of a control step
constexpr int kFullLevel = 5;
constexpr char kNominalColor[] = "#e69f00", kFullColor[] = "#0072b2", kInputColor[] = "#6b7280";

// One joint's parameters at one severity, and how its lines look.
struct Variant {
  std::string name;
  const char* color;
  JointErrorParameters p;
};

// Joint 0..6 at nominal severity, and as the scenario at L5 has it at the end of an episode.
std::array<Variant, 2> NominalAndFull(const std::string& scenario, int joint) {
  const JointErrorParameters nominal = NominalPandaErrors()[joint];
  const Scenario full = MakeScenario(scenario, kFullLevel).value();
  return {{{"nominal", kNominalColor, nominal},
           {"full severity", kFullColor, Scale(nominal, FactorsAt(full, 1, 1)[joint])}}};
}

struct Panel {
  std::string title, y_label;
  std::vector<LineSeries> lines;
};

LineSeries Line(const std::string& name, const char* color) { return {name, color, {}, {}}; }

void Append(LineSeries& line, int step, double y) {
  line.x.push_back(1000 * kStep * step);
  line.y.push_back(y);
}

// The range of the lines with a tenth of it on either side, so that ticks fall beside extremes.
void SetRange(const std::vector<LineSeries>& lines, LinePlotOptions& options) {
  double low = lines[0].y[0], high = low;
  for (const LineSeries& line : lines) {
    const auto [least, most] = std::minmax_element(line.y.begin(), line.y.end());
    low = std::min(low, *least), high = std::max(high, *most);
  }
  options.y_min = low - 0.1 * (high - low);
  options.y_max = high + 0.1 * (high - low);
}

std::string Sheet(const std::string& title, const std::vector<Panel>& panels, int columns) {
  PlotSheetOptions sheet;
  sheet.title = title;
  sheet.legend = {{"nominal", kNominalColor},
                  {"full severity (L5)", kFullColor},
                  {"input, the same for both", kInputColor}};
  sheet.columns = columns;
  sheet.plot_width = columns == 1 ? 860 : 430;
  sheet.plot_height = 210;
  std::vector<std::string> plots;
  for (const Panel& panel : panels) {
    LinePlotOptions options;
    options.title = panel.title;
    options.x_label = "time [ms]";
    options.y_label = panel.y_label;
    options.width = sheet.plot_width;
    options.height = sheet.plot_height;
    SetRange(panel.lines, options);
    plots.push_back(LinePlot(panel.lines, options));
  }
  return PlotSheet(plots, sheet);
}

// Prescribed velocity: the literal law, which has no memory. Panels: velocity, dry part, torque.
std::array<Panel, 3> FrictionOfAMovingJoint() {
  std::array<Panel, 3> panels = {{{"Input: joint velocity, prescribed", "velocity [rad/s]", {}},
                                  {"No hidden state; size of the dry part", "torque [Nm]", {}},
                                  {"Output: friction torque (sgn)", "torque [Nm]", {}}}};
  LineSeries velocity = Line("velocity", kInputColor);
  const auto dq = [](int i) { return 0.5 * std::sin(2 * M_PI * kStep * i / 0.8); };
  for (int i = 0; i <= 600; ++i) Append(velocity, i, dq(i));
  panels[0].lines = {velocity};
  for (const Variant& v : NominalAndFull("isolated_stribeck", 0)) {
    LineSeries dry = Line(v.name, v.color), torque = dry;
    for (int i = 0; i <= 600; ++i) {
      Append(dry, i, StribeckMagnitude(v.p, dq(i)));
      Append(torque, i, StribeckTorque(v.p, dq(i), FrictionLaw::kSgn, 0));
    }
    panels[1].lines.push_back(dry);
    panels[2].lines.push_back(torque);
  }
  return panels;
}

// A torque triangle on a joint of 5 kg m^2 at rest, friction law stick. Panels: torque, velocity,
// friction torque.
std::array<Panel, 3> FrictionOfAPushedJoint() {
  constexpr double kInertia = 5;  // armature of J1 [kg m^2]
  std::array<Panel, 3> panels = {{{"Input: driving torque", "torque [Nm]", {}},
                                  {"Hidden state: velocity of the joint", "velocity [rad/s]", {}},
                                  {"Output: friction torque (stick)", "torque [Nm]", {}}}};
  const auto drive = [](int i) { return 10 * std::max(0.0, 1 - std::abs(kStep * i - 0.6) / 0.6); };
  LineSeries input = Line("torque", kInputColor);
  for (int i = 0; i <= 1300; ++i) Append(input, i, drive(i));
  panels[0].lines = {input};
  for (const Variant& v : NominalAndFull("isolated_stribeck", 0)) {
    LineSeries velocity = Line(v.name, v.color), torque = velocity;
    double dq = 0;
    for (int i = 0; i <= 1300; ++i) {
      const double A = kStep / kInertia, viscous = -v.p.sigma_v * dq;
      std::array<double, 1> dry;
      const std::array limit = {StribeckMagnitude(v.p, dq)};
      StickTorques(std::array{dq + A * (drive(i) + viscous)}, std::array{A}, limit, limit,
                   absl::MakeSpan(dry));
      dq += A * (drive(i) + viscous + dry[0]);
      Append(velocity, i, dq);
      Append(torque, i, viscous + dry[0]);
    }
    panels[1].lines.push_back(velocity);
    panels[2].lines.push_back(torque);
  }
  return panels;
}

std::string DrawFriction() {
  std::vector<Panel> panels;
  const std::array<Panel, 3> moving = FrictionOfAMovingJoint(), pushed = FrictionOfAPushedJoint();
  for (size_t i = 0; i < moving.size(); ++i) {
    panels.push_back(moving[i]);
    panels.push_back(pushed[i]);
  }
  return Sheet("Friction, joint 1: Stribeck curve (left), breakaway at the static torque (right)",
               panels, 2);
}

// An object is held from 0.5 s to 1.2 s while the arm moves; nominal against Heavy Payload.
std::string DrawGravityResidual() {
  constexpr int kJoint = 1, kControlSteps = 36, kGrasp = 10, kRelease = 24;
  std::vector<Panel> panels = {
      {"Input: gravity torque of joint 2", "torque [Nm]", {Line("torque", kInputColor)}},
      {"Input: object held (grasp check)", "held", {Line("held", kInputColor)}},
      {"Hidden state: severity behind the grasp gate", "factor w_g", {}},
      {"Output: gravity residual", "torque [Nm]", {}}};
  for (const char* name : {"nominal", "heavy_payload"}) {
    const bool full = std::string(name) != "nominal";
    JointChain chain(7);
    chain.SetScenario(MakeScenario(name, kFullLevel).value(), kControlSteps);
    std::vector<JointMoment> moments(7);
    chain.Reset(moments);
    LineSeries factor = Line(name, full ? kFullColor : kNominalColor), residual = factor;
    for (int i = 0; i < kControlSteps * kSubSteps; ++i) {
      const int control_step = i / kSubSteps;
      const bool held = control_step >= kGrasp && control_step < kRelease;
      const double g = -25 + 12 * std::sin(2 * M_PI * kStep * i / 1.5);
      if (i % kSubSteps == 0) chain.BeginControlStep(control_step, held);
      chain.BeginSubStep(kStep);
      Append(factor, i, chain.severity().factors()[kJoint].gravity);
      std::vector<double> torque(7);
      moments[kJoint].gravity = g;
      chain.AddTorques(moments, absl::MakeSpan(torque));
      Append(residual, i, torque[kJoint]);
      if (full) continue;
      Append(panels[0].lines[0], i, g);
      Append(panels[1].lines[0], i, held);
    }
    panels[2].lines.push_back(factor);
    panels[3].lines.push_back(residual);
  }
  return Sheet("Gravity residual, joint 2: full severity is Heavy Payload", panels, 2);
}

std::string DrawBacklash() {
  std::vector<Panel> panels = {{"Input: motor angle", "angle [rad]", {Line("motor", kInputColor)}},
                               {"Hidden state: link angle", "angle [rad]", {}},
                               {"Output: link minus motor", "offset [rad]", {}}};
  const auto motor = [](int i) {
    const double t = kStep * i;
    return 0.04 * std::exp(-t / 1.2) * std::sin(2 * M_PI * t / 0.5);
  };
  for (int i = 0; i <= 1000; ++i) Append(panels[0].lines[0], i, motor(i));
  for (const Variant& v : NominalAndFull("isolated_backlash", 0)) {
    LineSeries link = Line(v.name, v.color), offset = link;
    Backlash backlash;
    backlash.Reset(motor(0));
    for (int i = 0; i <= 1000; ++i) {
      Append(offset, i, backlash.Step(v.p, motor(i)));
      Append(link, i, backlash.link_angle());
    }
    panels[1].lines.push_back(link);
    panels[2].lines.push_back(offset);
  }
  return Sheet("Backlash, joint 1: a deadband on every reversal", panels, 1);
}

std::string DrawCompliance() {
  std::vector<Panel> panels = {{"Input: load torque", "torque [Nm]", {Line("load", kInputColor)}},
                               {"Hidden state: rate of the deflection", "rate [rad/s]", {}},
                               {"Output: deflection", "deflection [rad]", {}}};
  const auto load = [](int i) { return i < 25 ? 0.0 : i < 125 ? 40.0 : i < 225 ? -20.0 : 0.0; };
  for (int i = 0; i <= 300; ++i) Append(panels[0].lines[0], i, load(i));
  for (const Variant& v : NominalAndFull("isolated_compliance", 0)) {
    LineSeries rate = Line(v.name, v.color), deflection = rate;
    Compliance compliance;
    compliance.Reset(0);
    for (int i = 0; i <= 300; ++i) {
      Append(deflection, i, compliance.Step(v.p, load(i), kStep));
      Append(rate, i, compliance.rate());
    }
    panels[1].lines.push_back(rate);
    panels[2].lines.push_back(deflection);
  }
  return Sheet("Compliance, joint 1: 14.7 Hz nominal, softer by sqrt(5) at full severity", panels,
               1);
}

}  // namespace

std::vector<ErrorModelPicture> DrawErrorModels() {
  return {{"friction", DrawFriction()},
          {"gravity_residual", DrawGravityResidual()},
          {"backlash", DrawBacklash()},
          {"compliance", DrawCompliance()}};
}

}  // namespace robostress
