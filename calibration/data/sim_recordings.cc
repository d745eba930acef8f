#include "calibration/data/sim_recordings.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <tuple>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"
#include "sim_worker/panda_mjcf.h"

namespace robostress::calibration {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> List(const fs::path& folder, bool directories) {
  std::vector<std::string> names;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) {
    if (entry.is_directory() == directories) names.push_back(entry.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace

absl::StatusOr<std::vector<std::string>> FindJointLogs(const std::string& run,
                                                       const std::string& unit) {
  fs::path folder = run;
  if (!fs::is_directory(folder))
    return absl::NotFoundError(absl::StrCat(run, ": no such directory"));
  if (fs::is_directory(folder / "units")) {
    const std::vector<std::string> units = List(folder / "units", true);
    const bool known = std::find(units.begin(), units.end(), unit) != units.end();
    if (unit.empty() ? units.size() != 1 : !known)
      return absl::InvalidArgumentError(absl::StrCat(
          run, ": ", unit.empty() ? "pick one unit with --unit" : "has no unit '" + unit + "'",
          "; it has ", absl::StrJoin(units, ", ")));
    folder = folder / "units" / (unit.empty() ? units.front() : unit);
  }
  std::vector<std::tuple<int, int, std::string>> found;
  for (const std::string& name : List(folder / "joints", false)) {
    int task = 0, episode = 0, length = 0;
    if (std::sscanf(name.c_str(), "task%d_episode%d.safetensors%n", &task, &episode, &length) !=
            2 ||
        length != static_cast<int>(name.size()))
      continue;
    found.emplace_back(task, episode, (folder / "joints" / name).string());
  }
  if (found.empty())
    return absl::NotFoundError(
        absl::StrCat(folder.string(),
                     ": holds no joint logs; record them with `robostress sweep "
                     "--record-joints` or `robostress worker --record-joints`"));
  std::sort(found.begin(), found.end());
  std::vector<std::string> files;
  for (const auto& [task, episode, file] : found) files.push_back(file);
  return files;
}

absl::StatusOr<RecordedEpisode> EpisodeOfJointLog(const JointLog& log, double rate_hz) {
  const double ratio = JointLog::kRateHz / rate_hz;
  const auto stride = static_cast<size_t>(std::lround(ratio));
  if (!(rate_hz > 0) || stride < 1 || std::abs(ratio - static_cast<double>(stride)) > 1e-9)
    return absl::InvalidArgumentError(absl::StrCat("rate ", rate_hz,
                                                   " Hz does not divide the recorded ",
                                                   JointLog::kRateHz, "; 500, 250, 125 or 100 do"));
  RecordedEpisode episode;
  episode.name = absl::StrCat("task", log.task, "_episode", log.episode);
  episode.group = absl::StrCat(log.suite, " task ", log.task);
  episode.rate_hz = rate_hz;
  episode.q.resize(7);
  episode.dq.resize(7);
  episode.tau.resize(7);
  for (size_t i = 0; i + stride < log.samples.size(); i += stride) {
    const JointSample& sample = log.samples[i];
    JointSample::Vector tau = 0.5 * (sample.tau + log.samples[i + stride].tau);
    double contact = sample.contact_N;
    for (size_t k = 1; k < stride; ++k) {
      tau += log.samples[i + k].tau;
      contact = std::max(contact, log.samples[i + k].contact_N);
    }
    tau /= static_cast<double>(stride);
    episode.t.push_back(sample.t);
    episode.contact_N.push_back(contact);
    for (int j = 0; j < 7; ++j) {
      episode.q[j].push_back(sample.q[j]);
      // The simulator's velocity is that of the way here; half of it and half of the way on.
      episode.dq[j].push_back(0.5 * (sample.dq[j] + log.samples[i + 1].dq[j]));
      episode.tau[j].push_back(tau[j]);
    }
  }
  return episode;
}

RecordedArm PandaOfRecordings(const std::string& rig_name) {
  RecordedArm arm;
  arm.name = rig_name;
  arm.model_file = "panda_arm.xml";
  arm.mjcf = ComposePandaArm();
  arm.velocity = VelocitySide::kMotor;  // backlash and compliance act on positions
  for (int j = 1; j <= 7; ++j) arm.joints.push_back(absl::StrCat("robot0_joint", j));
  return arm;
}

}  // namespace robostress::calibration
