#include "calibration/model/model_file.h"

#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <exception>
#include <filesystem>
#include <system_error>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "calibration/model/mjcf_reduction.h"
#include "common/atomic_file.h"
#include "common/models/urdf_model.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

constexpr uint64_t kMostBytes = 16 << 20;  // of text; meshes are other files

std::string OneLine(std::string text) {
  absl::StripAsciiWhitespace(&text);
  return absl::StrReplaceAll(text, {{"\n\n", ", "}, {"\n", ", "}});
}

// MuJoCo's C function lets exceptions of its parts through: of a mesh file's name without an
// ending.
CompiledModel LoadXml(const char* name, const mjVFS* files, std::string* refusal) {
  char error[1000] = "";
  CompiledModel model;
  try {
    model.reset(mj_loadXML(name, files, error, sizeof error));
    *refusal = error;
  } catch (const std::exception& thrown) {
    *refusal = absl::StrCat("MuJoCo ends with \"", thrown.what(),
                            "\"; has every mesh file's name an ending?");
  }
  return model;
}

absl::StatusOr<LoadedModel> LoadUrdf(const Rig& rig, const XmlFile& file) {
  std::vector<std::string> moving;
  for (const RigJoint& joint : rig.joints) moving.push_back(joint.name);
  RS_ASSIGN_OR_RETURN(UrdfModel urdf, ReadUrdf(file, moving));
  LoadedModel loaded;
  RS_ASSIGN_OR_RETURN(loaded.model, CompileModel(file.name(), urdf.xml));
  loaded.effort = std::move(urdf.effort);
  loaded.urdf = true;
  loaded.payload_link = urdf.payload_link;
  loaded.facts = std::move(urdf.facts);
  return loaded;
}

void DescribeGravity(const Rig& rig, bool urdf, LoadedModel& loaded) {
  double* const gravity = loaded.model->opt.gravity;
  if (rig.gravity) std::copy(rig.gravity->begin(), rig.gravity->end(), gravity);
  loaded.facts.insert(
      loaded.facts.begin() + 1,
      {"model", "gravity",
       absl::StrFormat("%g %g %g m/s^2 in the base's frame", gravity[0], gravity[1], gravity[2]),
       rig.gravity ? FactSource::kRig
       : urdf      ? FactSource::kAssumed
                   : FactSource::kRead,
       rig.gravity || !urdf
           ? ""
           : "gravity: [x, y, z] of the rig, of an arm that is not mounted upright"});
}

// Of a URDF none is left.
void DescribeHeld(const Rig& rig, LoadedModel& loaded) {
  std::vector<std::string> held;
  for (int id = 0; id < loaded.model->njnt; ++id) {
    const char* name = mj_id2name(loaded.model.get(), mjOBJ_JOINT, id);
    const auto is = [&](const RigJoint& joint) { return name != nullptr && joint.name == name; };
    if (std::none_of(rig.joints.begin(), rig.joints.end(), is))
      held.push_back(name == nullptr ? "(nameless)" : name);
  }
  if (!held.empty()) loaded.facts.push_back(HeldFact(held));
}

// What drives and brakes a joint of the rig, in the order in which it is worth doubting.
void DescribeJoint(const RigJoint& joint, bool urdf, LoadedModel& loaded) {
  const mjModel& model = *loaded.model;
  const int id = mj_name2id(&model, mjOBJ_JOINT, joint.name.c_str());
  if (id < 0) return;  // Plant says so, with the joints that there are
  const int dof = model.jnt_dofadr[id];
  const bool slide = model.jnt_type[id] == mjJNT_SLIDE;
  const auto add = [&](const char* what, std::string value, FactSource source, std::string remedy) {
    loaded.facts.push_back({joint.name, what, std::move(value), source, std::move(remedy)});
  };
  const double* range = model.jnt_range + 2 * id;
  add("type",
      absl::StrCat(slide ? "slide" : "hinge",
                   model.jnt_limited[id] ? absl::StrFormat(" from %.4g to %.4g %s", range[0],
                                                           range[1], slide ? "m" : "rad")
                                         : " without stops"),
      FactSource::kRead, "");
  // A value of the rig or of its fit stands above the file's; 0 in the file says nothing.
  const auto value = [&](const char* what, double in_file, const char* unit) {
    const auto declared = joint.parameters.find(what);
    const bool fitted = std::find(joint.fit.begin(), joint.fit.end(), what) != joint.fit.end();
    const bool in_rig = declared != joint.parameters.end();
    const double number = in_rig ? declared->second : in_file;
    add(what, absl::StrCat(absl::StrFormat("%.4g %s", number, unit), fitted ? ", fitted" : ""),
        fitted || in_rig ? FactSource::kRig
        : in_file != 0   ? FactSource::kRead
                         : FactSource::kAssumed,
        fitted || in_rig || in_file != 0 ? "" : "name it in the joint's fit");
  };
  value("armature", model.dof_armature[dof], slide ? "kg" : "kg m^2");
  value("damping", model.dof_damping[dof], slide ? "N s/m" : "Nm s/rad");
  value("frictionloss", model.dof_frictionloss[dof], slide ? "N" : "Nm");
  if (const double stiffness = model.jnt_stiffness[id]; stiffness != 0)
    add("stiffness", absl::StrFormat("%.4g %s", stiffness, slide ? "N/m" : "Nm/rad"),
        FactSource::kRead, "few arms have a spring; take it out of the model");
  const auto effort = loaded.effort.find(joint.name);
  if (!urdf || joint.input != JointInput::kPositionTarget || joint.servo.type != Servo::Type::kPd)
    return;
  const char* unit = slide ? "N" : "Nm";
  if (std::isfinite(joint.servo.torque_limit)) {
    add("torque limit", absl::StrFormat("%.4g %s", joint.servo.torque_limit, unit),
        FactSource::kRig, "");
  } else if (effort != loaded.effort.end()) {
    add("torque limit", absl::StrFormat("%.4g %s", effort->second, unit), FactSource::kAssumed,
        "<limit effort>, which many files only fill in; servo.torque_limit of the rig sets it");
  } else {
    add("torque limit", "none", FactSource::kAssumed, "servo.torque_limit of the rig sets it");
  }
}

}  // namespace

absl::StatusOr<CompiledModel> CompileModel(const std::string& file, const std::string& xml) {
  constexpr char kName[] = "model.xml";
  const auto files = std::make_unique<mjVFS>();
  mj_defaultVFS(files.get());
  if (mj_makeEmptyFileVFS(files.get(), kName, static_cast<int>(xml.size())) != 0)
    return absl::ResourceExhaustedError(absl::StrCat(file, ": no memory for the model"));
  std::copy(xml.begin(), xml.end(),
            static_cast<char*>(files->filedata[mj_findFileVFS(files.get(), kName)]));
  std::string refusal;
  CompiledModel model = LoadXml(kName, files.get(), &refusal);
  mj_deleteVFS(files.get());
  if (model == nullptr)
    return absl::InvalidArgumentError(absl::StrCat(file, ": does not load: ", refusal));
  return model;
}

absl::StatusOr<LoadedModel> LoadMjcf(const XmlFile& file) {
  LoadedModel loaded;
  std::string refusal;
  loaded.model = LoadXml(file.name().c_str(), nullptr, &refusal);
  std::vector<ModelFact> left_out;
  if (loaded.model == nullptr) {
    std::string without_shapes;  // why
    absl::StatusOr<CompiledModel> compiled = absl::UnknownError("");
    std::vector<std::string> refusals;
    for (const MjcfShapes shapes : {MjcfShapes::kKept, MjcfShapes::kLeftOut}) {
      auto reduced = ReduceMjcf(file, shapes);
      compiled = reduced.ok() ? CompileModel(file.name(), reduced->xml) : reduced.status();
      if (reduced.ok()) left_out = std::move(reduced->facts);
      if (compiled.ok()) break;
      without_shapes = OneLine(std::string(compiled.status().message()));
      refusals.push_back(without_shapes);
    }
    if (!compiled.ok())
      return absl::InvalidArgumentError(absl::StrCat(
          file.name(), ": does not load: ", refusal, "\nnor without its actuators: ", refusals[0],
          refusals[1] == refusals[0] ? ""
                                     : absl::StrCat("\nnor without its shapes: ", refusals[1])));
    if (!without_shapes.empty())
      left_out.push_back({"model", "shapes", "all", FactSource::kLeftOut, without_shapes});
    loaded.model = *std::move(compiled);
  }
  loaded.facts.push_back(
      {"model", "format",
       absl::StrCat("MJCF, ", loaded.model->nbody - 1, " bodies, ", loaded.model->njnt, " joints"),
       FactSource::kRead, ""});
  loaded.facts.insert(loaded.facts.end(), left_out.begin(), left_out.end());
  return loaded;
}

absl::StatusOr<std::string> MjcfOf(const std::string& file, const std::string& xml) {
  RS_ASSIGN_OR_RETURN(const CompiledModel model, CompileModel(file, xml));
  std::error_code error;
  const std::filesystem::path folder = std::filesystem::temp_directory_path(error);
  std::string path = (folder / "robostress_model_XXXXXX").string();
  const int descriptor = mkstemp(path.data());
  if (descriptor < 0)
    return absl::UnavailableError(absl::StrCat(path,
                                               ": cannot be made; set TMPDIR to a folder "
                                               "that can be written to"));
  close(descriptor);
  char why[1000] = "";
  // MuJoCo writes into files alone, and only what it has compiled last.
  const int saved = mj_saveLastXML(path.c_str(), model.get(), why, sizeof why);
  absl::StatusOr<std::string> text = ReadFileUpTo(path, kMostBytes);
  std::filesystem::remove(path, error);
  if (saved == 0) return absl::InternalError(absl::StrCat(file, ": ", why));
  return text;
}

absl::StatusOr<LoadedModel> LoadModel(const Rig& rig) {
  if (!std::filesystem::exists(rig.model))
    return absl::NotFoundError(absl::StrCat(rig.model, ": no such file; 'model' of ", rig.file));
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(rig.model, kMostBytes));
  RS_ASSIGN_OR_RETURN(const XmlFile file, XmlFile::Parse(rig.model, text));
  const absl::string_view root = file.root().Name();
  const bool urdf = root == "robot";
  if (!urdf && root != "mujoco")
    return file.Error(file.root(), absl::StrCat("does not load: its root is <", root,
                                                ">, must be <mujoco> (MJCF) or <robot> (URDF)"));
  RS_ASSIGN_OR_RETURN(LoadedModel loaded, urdf ? LoadUrdf(rig, file) : LoadMjcf(file));
  DescribeGravity(rig, urdf, loaded);
  DescribeHeld(rig, loaded);
  for (const RigJoint& joint : rig.joints) DescribeJoint(joint, urdf, loaded);
  return loaded;
}

}  // namespace robostress::calibration
