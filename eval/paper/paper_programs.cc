#include "eval/paper/paper_programs.h"

#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <memory>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "eval/paper/paper_results.h"
#include "eval/paper/piper_tables.h"
#include "eval/report/paper_values.h"
#include "eval/store/run_directory.h"
#include "eval/store/run_store.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;

std::string FolderOf(const ProgramRequest& request) {
  // Apart, so that a quick result is never taken for a full one.
  return absl::StrCat(request.out, "/", request.table.program, request.full ? "" : "-quick");
}

// Runs a command to its end on this process's own streams; its exit code, 128 + signal when killed.
absl::StatusOr<int> RunToEnd(const std::vector<std::string>& command) {
  std::vector<char*> arguments;
  for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
  arguments.push_back(nullptr);
  std::fflush(nullptr);
  const pid_t child = fork();
  if (child < 0) return absl::InternalError(absl::StrCat("cannot start ", command[0]));
  if (child == 0) {
    dup2(STDERR_FILENO, STDOUT_FILENO);
    execv(arguments[0], arguments.data());
    _exit(127);
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

// {"value_mm": .., "interval_mm": [low, high]}
absl::StatusOr<FilledCell> Millimetres(const std::string& file, const json& contender,
                                       const char* field) {
  const auto found = contender.find(field);
  if (found == contender.end() || !found->is_object() || !found->contains("value_mm") ||
      !(*found)["value_mm"].is_number()) {
    return absl::DataLossError(absl::StrCat(file, ": contender without number ", field,
                                            ".value_mm; remove the folder and run it again"));
  }
  FilledCell cell;
  cell.value = (*found)["value_mm"].get<double>();
  const auto interval = found->find("interval_mm");
  if (interval != found->end() && interval->is_array() && interval->size() == 2)
    cell.interval = {(*interval)[0].get<double>(), (*interval)[1].get<double>()};
  return cell;
}

// Throws json::exception where a field has another type.
absl::StatusOr<FilledTable> ReadPayload(const std::string& json_file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(json_file));
  const json result = json::parse(text, nullptr, false);
  if (!result.is_object() || !result.contains("contenders") || !result["contenders"].is_array()) {
    return absl::DataLossError(
        absl::StrCat(json_file, ": no list contenders; remove the folder and run it again"));
  }
  const PublishedTable& published = *FindPublished("payload");
  FilledTable table;
  table.name = published.name;
  table.label = published.label;
  table.caption = published.caption;
  table.row_heading = "Model";
  table.decimals = 2;
  table.reading =
      "Intervals: 95 % over layouts and measured replays. n: replays in which the object was held.";
  table.groups = {
      {"simulated Panda [mm]", false, {"DTW per step to the loaded arm", "rise after the grasp"}}};
  // What the models are compared with: the loaded arm's own rise, and its distance from itself.
  if (const auto measured = result.find("measured"); measured != result.end() &&
                                                     measured->contains("rise") &&
                                                     measured->contains("dtw_between_replays_mm")) {
    FilledRow row{"the loaded arm, replay to replay", false, {FilledCell()}};
    row.cells[0].value = measured->value("dtw_between_replays_mm", 0.0);
    RS_ASSIGN_OR_RETURN(const FilledCell rise, Millimetres(json_file, *measured, "rise"));
    row.cells.push_back(rise);
    for (FilledCell& cell : row.cells) cell.n = measured->value("loaded_replays", 0);
    table.rows.push_back(row);
  }
  for (const json& contender : result["contenders"]) {
    FilledRow row{contender.value("name", "?"), false, {}};
    for (const char* field : {"dtw_per_step", "rise"}) {
      RS_ASSIGN_OR_RETURN(FilledCell cell, Millimetres(json_file, contender, field));
      cell.n = contender.value("replays", 0) - contender.value("lost", 0);
      row.cells.push_back(cell);
    }
    table.rows.push_back(row);
  }
  table.notes = {
      absl::StrCat("Paper: ", published.protocol, "."),
      "Ours: the loaded arm is simulated too, a true mass in the gripper of the Panda, "
      "unless `robostress fidelity --measured` reads a real one's replays.",
      absl::StrCat("Profiles and fitted factors: fidelity.html beside ", json_file, ".")};
  return table;
}

}  // namespace

absl::StatusOr<std::vector<std::string>> ProgramCommand(const ProgramRequest& request) {
  RS_ASSIGN_OR_RETURN(const std::string program, FindProgram(request.table.program));
  std::vector<std::string> command = {program};
  if (request.table.program == "fidelity") {
    command.insert(command.end(), {"--out", FolderOf(request)});
    if (!request.full) command.insert(command.end(), {"--layouts", "3", "--noise-draws", "1"});
    return command;
  }
  // Its defaults are the paper's protocol; one study serves the three tables.
  command.insert(command.end(), {"--out", FolderOf(request)});
  if (!request.full) command.push_back("--quick");
  return command;
}

absl::StatusOr<FilledTable> RunPaperProgram(const ProgramRequest& request) {
  const std::string folder = FolderOf(request), result = folder + "/fidelity.json";
  const bool payload = request.table.program == "fidelity";
  if (!payload || !std::filesystem::exists(result)) {
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> command, ProgramCommand(request));
    RS_RETURN_IF_ERROR(MakeDirectories(folder));
    RS_ASSIGN_OR_RETURN(const int code, RunToEnd(command));
    if (code != 0) {
      return absl::InternalError(absl::StrCat("`", absl::StrJoin(command, " "),
                                              "` ended with exit code ", code,
                                              "; its messages are above"));
    }
  }
  if (payload) return PayloadTable(result);
  RS_ASSIGN_OR_RETURN(const RunData run, LoadRun(folder));
  RS_ASSIGN_OR_RETURN(const std::vector<SweepGrid> grids, RunDirectory(folder).Grids());
  RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, PaperUnits(grids));
  return FillPaperTable(request.table, PiperProtocol(folder), run, units,
                        request.bootstrap_replicates);
}

absl::StatusOr<FilledTable> PayloadTable(const std::string& json_file) {
  try {
    return ReadPayload(json_file);
  } catch (const json::exception& error) {
    return absl::DataLossError(
        absl::StrCat(json_file, ": ", error.what(), "; remove the folder and run it again"));
  }
}

std::optional<double> PiperResidualOf(const std::string& output, const std::string& profile) {
  // | new | 0 | 31.6 % | ...
  for (const absl::string_view line : absl::StrSplit(output, '\n')) {
    std::vector<std::string> cells;
    for (const absl::string_view cell : absl::StrSplit(line, '|'))
      cells.emplace_back(absl::StripAsciiWhitespace(cell));
    double percent = 0;
    if (cells.size() < 4 || cells[1] != profile || cells[2] != "0") continue;
    if (absl::SimpleAtod(absl::StripSuffix(cells[3], " %"), &percent)) return percent;
  }
  return std::nullopt;
}

absl::Status AddPiperResiduals(int episodes, FilledTable& table) {
  const PublishedTable& published = *FindPublished("residual");
  const std::string program = ProgramFolder() + "/piper_residual";
  std::string output;
  if (access(program.c_str(), X_OK) == 0) {
    const std::unique_ptr<FILE, int (*)(FILE*)> pipe(
        popen(absl::StrCat("'", program, "' --episodes ", episodes).c_str(), "r"), pclose);
    char buffer[4096];
    while (pipe != nullptr && std::fgets(buffer, sizeof buffer, pipe.get()) != nullptr)
      output += buffer;
  }
  for (const std::string profile : {"new", "used_one_year"}) {
    FilledRow row{profile == "new" ? "Robot A, emulated" : "Robot B, emulated", false, {}};
    for (const FilledGroup& group : table.groups) {
      for (size_t c = 0; c < group.columns.size(); ++c) {
        FilledCell cell;
        if (group.published) {
          cell.value = published.groups[0].values[published.RowOf(profile)][0];
        } else if (const auto percent = PiperResidualOf(output, profile)) {
          cell.value = percent;
          cell.n = episodes;
        }
        row.cells.push_back(cell);
      }
    }
    table.rows.push_back(row);
  }
  table.notes.push_back(
      output.empty()
          ? "The program piper_residual is not in this build: the emulated arms' rows are empty."
          : "Robot A and B: emulated Pipers of profiles new and used_one_year, joint space, mean "
            "over reaches (piper_residual); not on one scale with the simulation's rows.");
  return absl::OkStatus();
}

}  // namespace robostress
