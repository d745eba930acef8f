#include "common/unit/unit_runner.h"

#include <map>
#include <memory>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/joint_errors/scenario_file.h"
#include "common/libero/fixtures.h"
#include "common/libero/own_tasks.h"
#include "common/libero/task_folder.h"
#include "common/records/json_record.h"
#include "common/records/server_row.h"
#include "common/status_macros.h"
#include "common/unit/robots.h"

namespace robostress {
namespace {

// "episode 3/20  task 1 state 2  success  87 steps  2 updates  residual 0.310  1.90 s"
std::string ProgressLine(size_t index, size_t total, const PlayedEpisode& played) {
  const EpisodeRow& row = played.row;
  return absl::StrFormat(
      "episode %d/%d  task %d state %d  %s  %d steps  %d updates  residual %.3f  %.2f s", index + 1,
      total, row.task, row.initial_state, row.success ? "success" : "failure", row.steps,
      row.updates, row.residual.value_or(0), played.timing.wall_s.value_or(0));
}

class UnitRun {
 public:
  UnitRun(const UnitConfig& unit, std::vector<PlannedEpisode> plan, const UnitRunOptions& options,
          UnitPlayer& player)
      : unit_(unit), plan_(std::move(plan)), options_(options), player_(player) {}

  absl::Status Run() {
    RS_ASSIGN_OR_RETURN(directory_, UnitDirectory::Open(options_.out, unit_, plan_));
    if (directory_->done()) {
      Say(absl::StrCat("already complete: ", plan_.size(), " episodes in ", options_.out));
      return absl::OkStatus();
    }
    RS_ASSIGN_OR_RETURN(const std::string model_hash, player_.Open());
    std::map<std::string, std::string> notes = player_.Provenance();
    RS_RETURN_IF_ERROR(NoteFiles(notes));
    RS_RETURN_IF_ERROR(directory_->CheckModel(unit_.policy, model_hash, notes));
    RS_RETURN_IF_ERROR(Resume());
    while (directory_->episodes() < plan_.size())
      RS_RETURN_IF_ERROR(PlayOne(directory_->episodes()));
    RS_ASSIGN_OR_RETURN(const std::optional<std::string> adapter, Export());
    return directory_->Finish(adapter ? &*adapter : nullptr);
  }

 private:
  absl::StatusOr<std::optional<std::string>> Export() {
    if (!unit_.method->adapts()) return std::nullopt;
    return player_.Export();
  }

  absl::Status NoteFiles(std::map<std::string, std::string>& notes) const {
    if (IsScenarioFile(unit_.scenario)) {
      RS_ASSIGN_OR_RETURN(notes[kScenarioSha256], Sha256OfFile(unit_.scenario));
    }
    const std::string own = LiberosOwnFolder(unit_.libero_root, unit_.suite);
    if (!unit_.libero_tasks.empty()) {
      RS_ASSIGN_OR_RETURN(notes[kLiberoTasksSha256], LiberoTasksSha256(unit_.libero_tasks));
    } else if (!own.empty()) {
      notes[kLiberoTasksSha256] = LiberosOwnSha256(own);
    }
    RS_ASSIGN_OR_RETURN(const LiberoFixtures fixtures, ParseLiberoFixtures(unit_.libero_fixtures));
    if (!fixtures.table.empty()) {
      RS_ASSIGN_OR_RETURN(notes[kLiberoFixturesSha256], Sha256OfFile(fixtures.table));
    }
    return absl::OkStatus();
  }

  absl::Status Resume() {
    RS_ASSIGN_OR_RETURN(const RobotInfo robot, FindRobot(unit_.robot));
    if (!robot.episodes_stand_alone) {
      if (directory_->episodes() == 0) return absl::OkStatus();
      return StartOver("an episode of this robot depends on those before it");
    }
    if (unit_.method->adapts()) {
      const absl::StatusOr<std::string> state = directory_->LoadAdapterState();
      if (state.ok()) {
        RS_RETURN_IF_ERROR(player_.Import(*state));
      } else if (!absl::IsNotFound(state.status())) {
        return state.status();
      } else if (directory_->episodes() > 0) {
        RS_RETURN_IF_ERROR(StartOver(state.status().message()));
      }
    }
    if (directory_->episodes() > 0) {
      Say(absl::StrCat("continuing after ", directory_->episodes(), " of ", plan_.size(),
                       " episodes"));
    }
    return absl::OkStatus();
  }

  absl::Status StartOver(absl::string_view why) {
    Say(absl::StrCat("starting over: ", why));
    return directory_->Restart();
  }

  absl::Status PlayOne(size_t index) {
    const PlannedEpisode& planned = plan_[index];
    RS_RETURN_IF_ERROR(NoteServer(planned));
    RS_ASSIGN_OR_RETURN(PlayedEpisode played, player_.Play(planned, *directory_));
    RS_RETURN_IF_ERROR(NoteServer(planned));  // before the row that it is about
    RS_ASSIGN_OR_RETURN(const std::optional<std::string> state, Export());
    played.row.task = played.timing.task = planned.task;
    played.row.episode = played.timing.episode = planned.episode;
    played.row.initial_state = planned.initial_state;
    RS_RETURN_IF_ERROR(directory_->Append(EpisodeLine(IdentityOf(unit_, planned), played.row),
                                          TimingLine(played.timing), state ? &*state : nullptr));
    Say(ProgressLine(index, plan_.size(), played));
    return absl::OkStatus();
  }

  // Keeps who answers, where that is new, and how often the connection broke.
  absl::Status NoteServer(const PlannedEpisode& planned) {
    const std::optional<PolicyServer> now = player_.Server();
    if (!now || now == noted_) return absl::OkStatus();
    ServerRow row;
    row.task = planned.task, row.episode = planned.episode;
    row.url = now->url;
    row.metadata_sha256 = Sha256Hex(now->metadata);
    row.reconnections = now->reconnections - (noted_ ? noted_->reconnections : 0);
    if (noted_ && noted_->metadata != now->metadata) row.metadata = now->metadata;
    RS_RETURN_IF_ERROR(directory_->AppendServer(RecordJson(row).dump()));
    noted_ = now;
    return absl::OkStatus();
  }

  void Say(std::string_view line) const {
    if (options_.progress) options_.progress(line);
  }

  const UnitConfig& unit_;
  const std::vector<PlannedEpisode> plan_;
  const UnitRunOptions& options_;
  UnitPlayer& player_;
  std::unique_ptr<UnitDirectory> directory_;
  std::optional<PolicyServer> noted_;
};

}  // namespace

absl::Status RunUnit(const UnitConfig& resolved, const UnitRunOptions& options,
                     UnitPlayer& player) {
  RS_ASSIGN_OR_RETURN(std::vector<PlannedEpisode> plan, PlanRange(resolved, options.episodes));
  return UnitRun(resolved, std::move(plan), options, player).Run();
}

}  // namespace robostress
