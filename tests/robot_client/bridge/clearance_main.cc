// How near an arm of a URDF is to itself and to a table at height 0, in poses within the file's
// limits, as JSON for clearance.py: what was read, which links are watched, poses and distances
// [m].
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <nlohmann/json.hpp>
#include <random>
#include <string>
#include <vector>

#include "common/atomic_file.h"
#include "common/models/urdf_model.h"
#include "common/robot_description.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "robot_client/bridge/chain_model.h"
#include "robot_client/piper/piper_model.h"

namespace robostress::bridge {
namespace {

using Json = nlohmann::json;
using Clock = std::chrono::steady_clock;

double SecondsSince(Clock::time_point start) {
  return std::chrono::duration<double>(Clock::now() - start).count();
}

absl::StatusOr<ArmLimits> LimitsOf(const std::string& file, const std::string& text,
                                   const std::vector<std::string>& joints) {
  RS_ASSIGN_OR_RETURN(const XmlFile xml, XmlFile::Parse(file, text));
  RS_ASSIGN_OR_RETURN(const UrdfModel urdf, ReadUrdf(xml, joints));
  ArmLimits limits;
  limits.axes = {static_cast<int>(joints.size()), false};
  for (size_t k = 0; k < joints.size(); ++k) {
    limits.lower[k] = -M_PI;
    limits.upper[k] = M_PI;
    for (const urdf::Joint& joint : urdf.joints) {
      if (joint.name != joints[k] || !joint.limited) continue;
      limits.lower[k] = joint.lower;
      limits.upper[k] = joint.upper;
    }
  }
  return limits;
}

struct Line {
  std::string file, tool;
  std::vector<std::string> joints, packages;
  int poses = 500;
  bool piper = false;
};

// Clearances of random poses within the limits; how long one took.
void Look(const ArmModel& model, const ArmLimits& limits, int count, Json* out) {
  std::mt19937 numbers(1);
  std::vector<ArmVector> poses(static_cast<size_t>(count));
  for (ArmVector& pose : poses) {
    pose = {};
    for (int k = 0; k < limits.axes.joints; ++k)
      pose[k] = std::uniform_real_distribution<double>(limits.lower[k], limits.upper[k])(numbers);
  }
  const Clock::time_point start = Clock::now();
  for (const ArmVector& pose : poses) {
    const ArmModel::Clearance clearance = model.ClearanceAt(pose);
    (*out)["poses"].push_back(
        {{"q", std::vector<double>(pose.begin(), pose.begin() + limits.axes.joints)},
         {"itself", clearance[ArmModel::kItself]},
         {"table", clearance[ArmModel::kTable]}});
  }
  (*out)["us_a_call"] = 1e6 * SecondsSince(start) / count;
}

// The Piper's own model; its zero is that of the vendor's description.
void LookAtPiper(int count, Json* out) {
  ArmLimits limits;
  limits.axes = {6, true};
  for (int j = 0; j < 6; ++j) {
    limits.lower[j] = kPiper.joints[j].lower;
    limits.upper[j] = kPiper.joints[j].upper;
  }
  for (int a = -1; a < 6; ++a)
    for (int b = a + 3; b < 6; ++b) (*out)["watched"].push_back({a, b});
  Look(piper::PiperModel(piper::Zero::kBefore_1_6_3, {}), limits, count, out);
}

absl::Status Run(const Line& line) {
  Json out = {{"seconds", 0},
              {"meshes", 0},
              {"missing", Json::array()},
              {"parts", 0},
              {"touching", 0},
              {"touching_most", ""},
              {"partly", 0},
              {"watched", Json::array()},
              {"poses", Json::array()}};
  if (line.piper) {
    LookAtPiper(line.poses, &out);
    std::printf("%s\n", out.dump().c_str());
    return absl::OkStatus();
  }
  const auto& [file, tool, joints, packages, count, piper] = line;
  ModelOptions options;
  options.tool = tool;
  options.packages = packages;
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  RS_ASSIGN_OR_RETURN(const ArmLimits limits, LimitsOf(file, text, joints));
  const Clock::time_point start = Clock::now();
  RS_ASSIGN_OR_RETURN(ArmChain chain, ReadArmChain(file, text, joints, limits, options));
  ChooseLinkPairs(limits, {}, 0, {}, &chain);
  out.update({{"seconds", SecondsSince(start)},
              {"meshes", chain.meshes},
              {"missing", chain.missing_meshes},
              {"parts", chain.body.size()},
              {"touching", chain.touching},
              {"touching_most", LinkPairName(chain.touching_most)},
              {"partly", chain.partly_near.size()}});
  for (const auto& [a, b] : chain.watched)
    out["watched"].push_back({chain.body[a].link, chain.body[b].link});
  Look(ChainModel(chain, {}), limits, count, &out);
  std::printf("%s\n", out.dump().c_str());
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress::bridge

int main(int argc, char** argv) {
  robostress::cli::App app("Says how near an arm is to itself and to a table.", "bridge_clearance");
  robostress::bridge::Line line;
  app.add_option("urdf", line.file, "of the arm");
  app.add_option("--tool", line.tool, "link that is the tool's point");
  app.add_option("--joints", line.joints, "from the base on")->delimiter(',');
  app.add_flag("--piper", line.piper, "the Piper's own model instead of a URDF");
  app.add_option("--packages", line.packages, "folders of its packages");
  app.add_option("--poses", line.poses, "how many")->check(robostress::cli::Range(1, 1000000));
  return robostress::RunMain(app, argc, argv, [&] { return robostress::bridge::Run(line); });
}
