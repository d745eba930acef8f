#include "tests/sim_worker/libero/picture_comparison.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <ctime>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "common/image.h"
#include "common/status_macros.h"
#include "sim_worker/libero/preprocess.h"

namespace robostress::libero {
namespace {

constexpr int kVisible = 16, kBlock = 8;
constexpr int kRaw = 256, kClient = 224;  // [px]
constexpr const char* kCameras[] = {"agentview", "robot0_eye_in_hand"};

absl::StatusOr<Image> ReadPicture(const SafetensorsFile& file, const std::string& name) {
  RS_ASSIGN_OR_RETURN(const TensorView view, file.Get(name));
  if (view.dtype != DType::kU8 || view.shape.size() != 3 || view.shape[2] != 3)
    return absl::InvalidArgumentError(absl::StrCat(file.path(), ": ", name, " is no picture"));
  Image image;
  image.height = static_cast<int>(view.shape[0]);
  image.width = static_cast<int>(view.shape[1]);
  image.data.assign(view.bytes.begin(), view.bytes.end());
  return image;
}

PolicySpec SpecOf(int size) {
  PolicySpec spec;
  spec.cameras = {kCameras[0], kCameras[1]};
  spec.image_width = spec.image_height = size;
  return spec;
}

double Largest(const Eigen::VectorXf& ours, const std::vector<double>& theirs) {
  double largest = 0;
  for (size_t i = 0; i < theirs.size(); ++i)
    largest = std::max(largest, std::abs(ours[static_cast<int>(i)] - theirs[i]));
  return largest;
}

// Adds the views of one observation, and returns how far its state is from the original's.
absl::StatusOr<double> CompareObservation(const SafetensorsFile& file, const std::string& moment,
                                          int size, LiberoSimTask& task,
                                          std::vector<ComparedPicture>& pictures) {
  RS_ASSIGN_OR_RETURN(const Observation observation, task.Observe(SpecOf(size)));
  for (const CameraView& view : observation.views) {
    const std::string camera = size == kRaw ? view.camera : absl::StrCat("client.", view.camera);
    RS_ASSIGN_OR_RETURN(const Image theirs, ReadPicture(file, absl::StrCat(moment, ".", camera)));
    if (theirs.width != size || theirs.height != size)
      return absl::InvalidArgumentError(absl::StrCat(file.path(), ": ", moment, ".", camera));
    pictures.push_back({moment, camera, Compare(view.image, theirs), view.image, theirs});
  }
  RS_ASSIGN_OR_RETURN(const std::vector<double> state,
                      file.ReadDoubles(absl::StrCat(moment, ".state"), {8}));
  return Largest(observation.proprioception, state);
}

absl::Status CompareSameState(const SafetensorsFile& file, const std::string& moment,
                              LiberoSimTask& task, ComparedTask& result) {
  const int nq = task.scene().model->nq;
  RS_ASSIGN_OR_RETURN(const std::vector<double> qpos,
                      file.ReadDoubles(absl::StrCat(moment, ".qpos"), {nq}));
  const std::vector<double> rest(task.scene().model->nv, 0.0);
  RS_RETURN_IF_ERROR(task.ResetTo(qpos, rest, LiberoSimTask::HomePosture()));
  for (const int size : {kRaw, kClient}) {
    RS_ASSIGN_OR_RETURN(const double error,
                        CompareObservation(file, moment, size, task, result.same_state));
    // Later the originals' fingers are of a step's end, and what pictures show of its start.
    if (absl::EndsWith(moment, "start")) result.start_proprioception = error;
  }
  return absl::OkStatus();
}

absl::Status CompareWholeWay(const SafetensorsFile& file, const std::string& trial, int state,
                             LiberoSimTask& task, ComparedTask& result) {
  const auto compare = [&](const char* moment) -> absl::Status {
    const std::string name = absl::StrCat(trial, moment);
    RS_ASSIGN_OR_RETURN(result.whole_way_proprioception[name],
                        CompareObservation(file, name, kClient, task, result.whole_way));
    return absl::OkStatus();
  };
  RS_RETURN_IF_ERROR(task.Reset(state));
  RS_RETURN_IF_ERROR(compare("settled"));
  if (file.tensors().count(trial + "actions") == 0) return absl::OkStatus();
  RS_ASSIGN_OR_RETURN(const std::vector<double> actions, file.ReadDoubles(trial + "actions"));
  for (size_t step = 0; step < actions.size() / 7; ++step) {
    const Eigen::Matrix<double, 7, 1> command =
        Eigen::Map<const Eigen::Matrix<double, 7, 1>>(actions.data() + 7 * step);
    RS_RETURN_IF_ERROR(task.StepExact(command, /*settling=*/false));
  }
  return compare("moved");
}

absl::StatusOr<double> CompareFixtures(const SafetensorsFile& file, const std::string& trial,
                                       const LiberoSimTask& task) {
  double largest = 0;
  for (const auto& [name, tensor] : file.tensors()) {
    const std::string prefix = trial + "fixture.";
    if (!absl::StartsWith(name, prefix)) continue;
    RS_ASSIGN_OR_RETURN(const std::vector<double> pose, file.ReadDoubles(name, {7}));
    const auto object = task.scene().objects.find(name.substr(prefix.size()));
    if (object == task.scene().objects.end())
      return absl::NotFoundError(absl::StrCat("fixture of ", name));
    const int body = object->second.body;
    for (int i = 0; i < 7; ++i) {
      const double ours = i < 3 ? task.placed_model().body_pos[3 * body + i]
                                : task.placed_model().body_quat[4 * body + i - 3];
      largest = std::max(largest, std::abs(ours - pose[i]));
    }
  }
  return largest;
}

// Arrays of the compiled model that decide pictures, by the name that look.py gives them.
std::map<std::string, std::vector<double>> VisualArrays(const mjModel& m) {
  std::map<std::string, std::vector<double>> arrays;
  const auto add = [&](const char* name, const auto* data, int rows, int columns) {
    arrays[name].assign(data, data + size_t(rows) * columns);
  };
  add("cam_pos", m.cam_pos, m.ncam, 3);
  add("cam_quat", m.cam_quat, m.ncam, 4);
  add("cam_fovy", m.cam_fovy, m.ncam, 1);
  add("geom_rgba", m.geom_rgba, m.ngeom, 4);
  add("geom_group", m.geom_group, m.ngeom, 1);
  add("site_group", m.site_group, m.nsite, 1);
  add("light_pos", m.light_pos, m.nlight, 3);
  add("light_dir", m.light_dir, m.nlight, 3);
  add("light_ambient", m.light_ambient, m.nlight, 3);
  add("light_diffuse", m.light_diffuse, m.nlight, 3);
  add("light_specular", m.light_specular, m.nlight, 3);
  add("light_castshadow", m.light_castshadow, m.nlight, 1);
  add("light_directional", m.light_directional, m.nlight, 1);
  add("light_attenuation", m.light_attenuation, m.nlight, 3);
  add("light_cutoff", m.light_cutoff, m.nlight, 1);
  add("light_exponent", m.light_exponent, m.nlight, 1);
  add("light_active", m.light_active, m.nlight, 1);
  add("mat_rgba", m.mat_rgba, m.nmat, 4);
  add("mat_specular", m.mat_specular, m.nmat, 1);
  add("mat_shininess", m.mat_shininess, m.nmat, 1);
  add("mat_reflectance", m.mat_reflectance, m.nmat, 1);
  add("mat_emission", m.mat_emission, m.nmat, 1);
  add("mat_texrepeat", m.mat_texrepeat, m.nmat, 2);
  add("mat_texuniform", m.mat_texuniform, m.nmat, 1);
  add("tex_height", m.tex_height, m.ntex, 1);
  add("tex_width", m.tex_width, m.ntex, 1);
  add("tex_type", m.tex_type, m.ntex, 1);
  add("mesh_facenum", m.mesh_facenum, m.nmesh, 1);
  arrays["extent"] = {m.stat.extent};
  return arrays;
}

}  // namespace

PictureDifference Compare(const Image& ours, const Image& theirs) {
  PictureDifference difference;
  const int width = ours.width, height = ours.height;
  int64_t sum = 0, visible = 0;
  for (size_t i = 0; i < ours.data.size(); ++i) {
    const int d = std::abs(int{ours.data[i]} - int{theirs.data[i]});
    sum += d;
    visible += d > kVisible;
    difference.largest = std::max(difference.largest, d);
  }
  const double count = static_cast<double>(ours.data.size());
  difference.mean = static_cast<double>(sum) / count;
  difference.visible = static_cast<double>(visible) / count;
  for (int top = 0; top + kBlock <= height; top += kBlock) {
    for (int left = 0; left + kBlock <= width; left += kBlock) {
      std::array<int, 3> signed_sum = {};
      for (int y = top; y < top + kBlock; ++y) {
        for (int i = 3 * left; i < 3 * (left + kBlock); ++i) {
          const size_t at = size_t{3} * y * width + i;
          signed_sum[i % 3] += int{ours.data[at]} - int{theirs.data[at]};
        }
      }
      for (const int channel : signed_sum) {
        difference.block = std::max(difference.block, std::abs(channel) / double{kBlock * kBlock});
      }
    }
  }
  return difference;
}

Image Beside(const Image& ours, const Image& theirs) {
  Image amplified = ours;
  for (size_t i = 0; i < ours.data.size(); ++i) {
    const int d = std::abs(int{ours.data[i]} - int{theirs.data[i]});
    amplified.data[i] = static_cast<uint8_t>(std::min(255, 8 * d));
  }
  return HStack({ours, theirs, amplified}, 4);
}

absl::StatusOr<DrawnOtherwise> CompareDrawn(const std::string& file_name, const std::string& suite,
                                            int index, const std::string& site,
                                            const RenderOptions& options) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(file_name));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<LiberoSimTask> task,
                      LiberoSimTask::Create(OriginalsUnit(suite, site), index));
  RS_ASSIGN_OR_RETURN(const std::shared_ptr<mjModel> model,
                      MakeRenderModel(task->scene(), task->placed_model()));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Renderer> renderer, Renderer::Create(model));
  RS_RETURN_IF_ERROR(task->Reset(0));
  DrawnOtherwise result;
  std::vector<double> times;
  int count = 0;
  for (const char* moment : {"0.start", "0.settled", "0.moved"}) {
    const auto qpos = file.ReadDoubles(absl::StrCat(moment, ".qpos"));
    if (!qpos.ok()) continue;
    const std::vector<double> rest(model->nv, 0.0);
    RS_RETURN_IF_ERROR(task->ResetTo(*qpos, rest, LiberoSimTask::HomePosture()));
    for (const char* camera : kCameras) {
      RS_ASSIGN_OR_RETURN(const Image theirs, ReadPicture(file, absl::StrCat(moment, ".", camera)));
      RS_RETURN_IF_ERROR(renderer->Render(task->sim().observed(), camera, options).status());
      const std::clock_t start = std::clock();
      RS_ASSIGN_OR_RETURN(const Image upright,
                          renderer->Render(task->sim().observed(), camera, options));
      times.push_back(static_cast<double>(std::clock() - start) / CLOCKS_PER_SEC);
      const PictureDifference difference = Compare(MirrorColumns(upright), theirs);
      result.mean += difference.mean;
      result.block = std::max(result.block, difference.block);
      ++count;
    }
  }
  if (count == 0) return absl::NotFoundError(absl::StrCat(file_name, ": no pictures of trial 0"));
  result.mean /= count;
  std::sort(times.begin(), times.end());
  result.cpu_s = times[times.size() / 2];
  return result;
}

UnitConfig OriginalsUnit(const std::string& suite, const std::string& site) {
  UnitConfig unit;
  unit.suite = suite;
  unit.libero_root = unit.robosuite_root = site;
  unit.libero_fixtures = "numpy:7";
  unit.sim.stepping = Stepping::kParity;
  return unit;
}

absl::StatusOr<ComparedTask> CompareTask(const std::string& file_name, const std::string& suite,
                                         int index, const std::string& site) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(file_name));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<LiberoSimTask> task,
                      LiberoSimTask::Create(OriginalsUnit(suite, site), index));
  if (!task->scene().missing_visuals.empty())
    return absl::NotFoundError(absl::StrCat(task->scene().missing_visuals.front(), " is missing"));
  ComparedTask result;
  std::set<int> trials;
  for (const auto& [name, tensor] : file.tensors()) {
    int trial = 0;
    if (absl::SimpleAtoi(name.substr(0, name.find('.')), &trial)) trials.insert(trial);
  }
  for (const int trial : trials) {
    const std::string prefix = absl::StrCat(trial, ".");
    RS_RETURN_IF_ERROR(CompareWholeWay(file, prefix, trial, *task, result));
    RS_ASSIGN_OR_RETURN(const double fixtures, CompareFixtures(file, prefix, *task));
    result.fixtures = std::max(result.fixtures, fixtures);
    for (const char* moment : {"start", "settled", "moved"}) {
      if (file.tensors().count(absl::StrCat(prefix, moment, ".qpos")) == 0) continue;
      RS_RETURN_IF_ERROR(CompareSameState(file, absl::StrCat(prefix, moment), *task, result));
    }
  }
  for (const auto& [name, ours] : VisualArrays(*task->scene().model)) {
    const auto theirs = file.ReadDoubles("model." + name);
    if (!theirs.ok()) continue;  // of another version of MuJoCo
    double& largest = result.model_arrays[name];
    if (theirs->size() != ours.size()) largest = 1e9;
    for (size_t i = 0; i < std::min(theirs->size(), ours.size()); ++i)
      largest = std::max(largest, std::abs((*theirs)[i] - ours[i]));
  }
  return result;
}

}  // namespace robostress::libero
