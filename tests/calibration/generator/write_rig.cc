#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"
#include "tests/calibration/generator/log_hardship.h"

namespace robostress::generator {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kCold = 22;              // [deg C]
constexpr double kTemperatureStep = 0.5;  // [K] of a sensor

// The point at `distance` from the joint along the link, at q = 0.
std::string Along(double phase, double distance) {
  return absl::StrFormat("%.10g 0 %.10g", -distance * std::sin(phase), -distance * std::cos(phase));
}

std::string JointMjcf(const GeneratedRig& rig, int index, const std::string& kind) {
  const Drive& drive = rig.declared.drives[index];
  const bool as_effect = rig.declares_dry_friction;
  return absl::StrFormat(
      R"(<joint name="%s" %s armature="%.10g" damping="%.10g" frictionloss="%.10g"/>)",
      rig.joint_names[index], kind, drive.armature, as_effect ? 0 : drive.viscous,
      as_effect ? 0 : drive.Fc);
}

std::string Inertial(const Link& link, const std::string& pos) {
  return absl::StrFormat(R"(<inertial pos="%s" mass="%.10g" diaginertia="%.10g %.10g %.10g"/>)",
                         pos, link.mass, link.inertia, link.inertia, link.inertia);
}

std::string Mjcf(const GeneratedRig& rig) {
  const Body& body = rig.declared.body;
  std::string text = "<mujoco>\n<option gravity=\"0 0 -9.81\"/>\n<worldbody>\n<body>\n";
  if (body.slide) {
    Link link = body.links[0];
    link.inertia = 0.01 * link.mass;
    absl::StrAppend(
        &text,
        JointMjcf(rig, 0,
                  absl::StrFormat(R"(type="slide" axis="%g 0 %g")", 1 - body.rise, body.rise)),
        "\n", Inertial(link, "0 0 0"), "\n<site name=\"tip\"/>\n</body>\n");
  } else {
    const std::string kind = R"(type="hinge" axis="0 1 0")";
    absl::StrAppend(&text, JointMjcf(rig, 0, kind), "\n",
                    Inertial(body.links[0], Along(body.phase, body.links[0].com)), "\n");
    if (body.links.size() == 2) {
      absl::StrAppend(&text, "<body pos=\"", Along(body.phase, body.links[0].length), "\">\n",
                      JointMjcf(rig, 1, kind), "\n",
                      Inertial(body.links[1], Along(body.phase, body.links[1].com)),
                      "\n<site name=\"tip\" pos=\"", Along(body.phase, body.links[1].length),
                      "\"/>\n</body>\n");
    } else {
      absl::StrAppend(&text, "<site name=\"tip\" pos=\"", Along(body.phase, body.links[0].length),
                      "\"/>\n");
    }
    absl::StrAppend(&text, "</body>\n");
  }
  return text + "</worldbody>\n</mujoco>\n";
}

std::string InputName(Family family) {
  if (family == Family::kTorque) return "torque";
  if (family == Family::kInverse) return "inverse";
  if (family == Family::kTransmission) return "transmission";
  return "position_target";
}

std::string RigYaml(const GeneratedRig& rig, const std::string& name) {
  std::string text =
      absl::StrFormat("name: %s\nmodel: model.xml\nrate_hz: %g\njoints:\n", name, rig.rate_hz);
  const bool servo = InputName(rig.family) == "position_target";
  for (size_t i = 0; i < rig.declared.drives.size(); ++i) {
    const Drive& drive = rig.declared.drives[i];
    absl::StrAppendFormat(&text, "  - name: %s\n    input: %s\n", rig.joint_names[i],
                          InputName(rig.family));
    if (servo) {
      absl::StrAppendFormat(&text, "    servo: {kp: %.10g, kd: %.10g", drive.kp, drive.kd);
      if (std::isfinite(drive.limit))
        absl::StrAppendFormat(&text, ", torque_limit: %.10g", drive.limit);
      absl::StrAppend(&text, drive.reads_motor ? ", feedback: motor}\n" : "}\n");
    }
    if (!rig.fit[i].empty())
      absl::StrAppend(&text, "    fit: [", absl::StrJoin(rig.fit[i], ", "), "]\n");
    if (rig.declares_dry_friction)
      absl::StrAppendFormat(&text,
                            "    effects:\n      - {type: stribeck_friction, Fc: %.10g, Fs: %.10g, "
                            "vs: %.10g, sigma_v: %.10g, fit: [%s]}\n",
                            drive.Fc, drive.Fs, drive.vs, drive.viscous,
                            absl::StrJoin(rig.friction_fit[i], ", "));
  }
  absl::StrAppend(&text, "logs:\n");
  for (size_t i = 0; i < rig.logs.size(); ++i)
    absl::StrAppendFormat(
        &text, "  - {file: log_%d.csv, role: %s%s}\n", i, rig.logs[i].role,
        rig.logs[i].overrides.empty() ? "" : ", overrides: {" + rig.logs[i].overrides + "}");
  absl::StrAppendFormat(&text, "metric: {type: %s_rmse, window_s: %g, unit: %s}\n",
                        rig.family == Family::kInverse ? "torque" : "position", rig.window_s,
                        rig.declared.body.slide ? "m" : "rad");
  return text;
}

std::string Csv(const GeneratedRig& rig, const Recording& log) {
  const bool two_sides = rig.family == Family::kTransmission;
  std::string text = "t";
  for (size_t i = 0; i < log.joints.size(); ++i) {
    const std::string& name = rig.joint_names[i];
    absl::StrAppend(&text, two_sides ? absl::StrCat(",q_motor_", name, ",q_link_", name)
                                     : absl::StrCat(",q_cmd_", name, ",q_", name));
    if (rig.logs_torque) absl::StrAppend(&text, ",tau_", name);
    if (rig.logs_temperature) absl::StrAppend(&text, ",temp_", name);
  }
  text += "\n";
  for (size_t k = 0; k < log.t.size(); ++k) {
    absl::StrAppendFormat(&text, "%.9g", log.t[k]);
    for (const JointChannels& joint : log.joints) {
      absl::StrAppendFormat(&text, ",%.10g,%.10g", two_sides ? joint.motor[k] : joint.command[k],
                            joint.q[k]);
      if (rig.logs_torque) absl::StrAppendFormat(&text, ",%.10g", joint.torque[k]);
      if (rig.logs_temperature)
        absl::StrAppendFormat(
            &text, ",%g",
            kCold + kTemperatureStep * std::round(joint.warmer[k] / kTemperatureStep));
    }
    text += "\n";
  }
  return text;
}

Json TruthJson(const GeneratedRig& rig, const RigOptions& options) {
  Json json = {{"seed", options.seed},
               {"family", FamilyName(rig.family)},
               {"size", static_cast<int>(options.size)},
               {"visibility", rig.visibility},
               {"commands_hold", rig.commands_hold},
               {"hardship", HardshipNames()[static_cast<size_t>(options.hardship)]},
               {"effects", Json::array()}};
  for (size_t i = 0; i < rig.truth.effects.size(); ++i) {
    const HiddenEffect& effect = rig.truth.effects[i];
    bool known = false;
    for (const std::string& name : LibraryEffects()) known |= name == effect.type;
    json["effects"].push_back({{"type", effect.type},
                               {"joint", rig.joint_names[effect.joint]},
                               {"parameters", effect.parameters},
                               {"visibility", rig.visibility_of[i]},
                               {"in_library", known},
                               {"near", NearEffects(effect.type)}});
  }
  for (size_t i = 0; i < rig.truth.drives.size(); ++i) {
    const Drive& d = rig.truth.drives[i];
    json["joints"].push_back({{"name", rig.joint_names[i]},
                              {"armature", d.armature},
                              {"viscous", d.viscous},
                              {"Fc", d.Fc},
                              {"Fs", d.Fs},
                              {"vs", d.vs}});
  }
  return json;
}

}  // namespace

absl::Status WriteGeneratedRig(const GeneratedRig& rig, const RigOptions& options,
                               const std::string& folder) {
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/model.xml", Mjcf(rig)));
  for (size_t i = 0; i < rig.logs.size(); ++i)
    RS_RETURN_IF_ERROR(WriteFileAtomically(absl::StrCat(folder, "/log_", i, ".csv"),
                                           Csv(rig, rig.logs[i].recording)));
  RS_RETURN_IF_ERROR(
      WriteFileAtomically(folder + "/truth.json", TruthJson(rig, options).dump(2) + "\n"));
  // The name tells nothing of what is hidden.
  return WriteFileAtomically(folder + "/rig.yaml",
                             RigYaml(rig, absl::StrCat("rig_", options.seed)));
}

}  // namespace robostress::generator
