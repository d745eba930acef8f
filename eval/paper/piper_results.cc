#include "eval/paper/piper_results.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <iterator>
#include <map>
#include <set>
#include <tuple>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "eval/paper/paper_results.h"
#include "eval/plan/titles.h"
#include "eval/report/paper_values.h"
#include "eval/statistics/comparison.h"
#include "eval/statistics/episode_bootstrap.h"
#include "eval/statistics/paired_tests.h"

namespace robostress {
namespace {

// What the paper calls the tasks (tab:real).
constexpr const char* kTaskTitles[] = {"1 bowl next to the plate", "2 bowl on the cabinet",
                                       "3 bowl on the box", "4 top drawer"};

struct PiperColumn {
  const char* title;
  const char* method;
};

std::vector<PiperColumn> ColumnsOf(const std::string& table) {
  if (table == "dob")
    return {{"Base", "base"}, {"DOB", "dob"}, {"Ours", "ours"}, {"DOB+Ours", "dob_ours"}};
  return {{"Base", "base"}, {"RobustVLA", "robust"}, {"Ours", "ours"}};
}

// A CSV without quotes, its columns found by name.
class EpisodeCsv {
 public:
  EpisodeCsv(const std::string& file, absl::string_view header)
      : file_(file), names_(absl::StrSplit(header, ',')) {}

  void NextRow(absl::string_view line) {
    ++line_;
    cells_ = absl::StrSplit(line, ',');
  }
  std::string Text(const std::string& column) {
    const auto at = std::find(names_.begin(), names_.end(), column) - names_.begin();
    if (at < static_cast<int>(cells_.size()) && cells_.size() == names_.size()) return cells_[at];
    Fail(column, at == static_cast<int>(names_.size()) ? "is missing" : "is missing in this row");
    return "";
  }
  int Int(const std::string& column, int low, int high) {
    const std::string text = Text(column);
    int value = 0;
    if (absl::SimpleAtoi(text, &value) && value >= low && value <= high) return value;
    Fail(column, absl::StrCat("is '", text, "', must be ", low, " to ", high));
    return low;
  }
  const absl::Status& status() const { return status_; }

 private:
  void Fail(const std::string& column, const std::string& what) {
    if (!status_.ok()) return;
    status_ = absl::DataLossError(
        absl::StrCat(file_, ":", line_, ": column ", column, " ", what,
                     "; `robostress piper-study report` writes the file again"));
  }
  const std::string& file_;
  const std::vector<std::string> names_;
  std::vector<std::string> cells_;
  int line_ = 1;
  absl::Status status_;
};

using Episodes = std::vector<const PiperEpisode*>;

Episodes Select(const std::vector<PiperEpisode>& all,
                const std::function<bool(const PiperEpisode&)>& use) {
  Episodes chosen;
  for (const PiperEpisode& episode : all) {
    if (use(episode)) chosen.push_back(&episode);
  }
  return chosen;
}

EpisodeValue ValueOf(const PiperEpisode& episode, double value) {
  // Every variant has states of its own.
  return {absl::StrCat(episode.variant), episode.task, episode.episode, episode.task, value};
}

FilledCell MakeCell(const Episodes& episodes, bool average, int replicates,
                    const std::string& label) {
  FilledCell cell;
  cell.n = static_cast<int>(episodes.size());
  if (episodes.empty()) return cell;
  int successes = 0, updates = 0;
  std::map<int, int> updates_of;  // of each task's session, at its last episode
  std::vector<EpisodeValue> values;
  for (const PiperEpisode* episode : episodes) {
    successes += episode->success;
    updates_of[episode->task] = std::max(updates_of[episode->task], episode->updates);
    values.push_back(ValueOf(*episode, episode->success));
  }
  for (const auto& [task, applied] : updates_of) updates += applied;
  const BootstrapResult mean = BootstrapEpisodes(values, average ? replicates : 0, label);
  const Interval interval = average ? mean.interval : WilsonInterval(successes, cell.n);
  cell.value = 100 * mean.estimate;
  cell.interval = {100 * interval.low, 100 * interval.high};
  if (episodes.front()->method == "ours" || episodes.front()->method == "dob_ours")
    cell.note = updates == 0 ? "not adapted" : absl::StrCat(updates, " updates");
  return cell;
}

// "+8.0 [-4.0, +20.0] +3/-1, p 0.62".
std::string ContrastText(const Episodes& method, const Episodes& reference, int replicates,
                         const std::string& label) {
  std::map<std::tuple<int, int, int>, bool> outcomes;
  for (const PiperEpisode* e : reference) outcomes[{e->task, e->variant, e->episode}] = e->success;
  std::vector<EpisodeValue> differences;
  int plus = 0, minus = 0;
  for (const PiperEpisode* e : method) {
    const auto pair = outcomes.find({e->task, e->variant, e->episode});
    if (pair == outcomes.end()) continue;
    plus += e->success && !pair->second;
    minus += !e->success && pair->second;
    differences.push_back(ValueOf(*e, static_cast<double>(e->success) - pair->second));
  }
  if (differences.empty()) return "-";
  const BootstrapResult d = BootstrapEpisodes(differences, replicates, label);
  const std::string ends =
      std::isfinite(d.interval.low)
          ? absl::StrFormat(" [%+.0f, %+.0f]", PercentagePoints(d.interval.low),
                            PercentagePoints(d.interval.high))
          : "";
  return absl::StrCat(absl::StrFormat("%+.0f", PercentagePoints(d.estimate)), ends, " +", plus,
                      "/-", minus, ", p ", PValueText(ExactMcNemar(plus, minus)));
}

}  // namespace

absl::StatusOr<std::vector<PiperEpisode>> ReadPiperEpisodes(const std::string& csv_file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(csv_file));
  const std::vector<std::string> lines = absl::StrSplit(text, '\n', absl::SkipEmpty());
  if (lines.size() < 2) {
    return absl::NotFoundError(
        absl::StrCat(csv_file, " holds no episode; run `robostress piper-study evaluate report`"));
  }
  EpisodeCsv csv(csv_file, lines[0]);
  std::vector<PiperEpisode> episodes;
  for (size_t i = 1; i < lines.size(); ++i) {
    csv.NextRow(lines[i]);
    PiperEpisode episode;
    episode.arm = csv.Text("arm");
    episode.policy = csv.Text("policy");
    episode.method = csv.Text("method");
    episode.task = csv.Int("task", 1, std::size(kTaskTitles));
    episode.variant = csv.Int("variant", 0, 1000);
    episode.episode = csv.Int("episode", 0, 1000000);
    episode.success = csv.Int("success", 0, 1) == 1;
    episode.updates = csv.Int("updates", 0, 1000000000);
    RS_RETURN_IF_ERROR(csv.status());
    episodes.push_back(episode);
  }
  return episodes;
}

FilledTable PiperTable(const std::string& table, const std::vector<PiperEpisode>& episodes,
                       int bootstrap_replicates) {
  const PublishedTable& published = *FindPublished(table);
  FilledTable filled;
  filled.name = table;
  filled.label = published.label;
  filled.caption = published.caption;
  filled.row_heading = "Task";
  const bool unseen = table == "unseen", all_tasks = table == "real-arm";
  std::vector<std::string> keys;
  for (size_t t = 0; t < (all_tasks ? std::size(kTaskTitles) : 1); ++t) {
    keys.push_back(absl::StrCat(t + 1));
    filled.rows.push_back({kTaskTitles[t], false, {}});
  }
  if (all_tasks) {
    keys.push_back("average");
    filled.rows.push_back({"Average", true, {}});
  }
  filled.differences = {{"Points [95 %] won/lost"}};
  for (const FilledRow& row : filled.rows) filled.differences[0].push_back(row.title);
  // DOB and unseen objects are Robot A's alone.
  const std::vector<std::pair<std::string, std::string>> arms =
      all_tasks
          ? std::vector<std::pair<std::string, std::string>>{{"new", "emulated Robot A"},
                                                             {"used_one_year", "emulated Robot B"}}
          : std::vector<std::pair<std::string, std::string>>{{"new", "emulated Robot A"}};
  for (const auto& [arm, title] : arms) {
    FilledGroup group{title, false, {}};
    const std::vector<PiperColumn> columns = ColumnsOf(table);
    const auto cell_episodes = [&, &arm = arm](size_t row, const PiperColumn& column) {
      return Select(episodes, [&](const PiperEpisode& e) {
        return e.arm == arm && e.method == column.method && (e.variant == 0) != unseen &&
               (filled.rows[row].average || e.task == static_cast<int>(row) + 1);
      });
    };
    for (const PiperColumn& column : columns) {
      group.columns.push_back(column.title);
      std::vector<std::string> line = {absl::StrCat(title, ": ", column.title, " - Base")};
      for (size_t r = 0; r < filled.rows.size(); ++r) {
        const std::string label =
            absl::StrCat("piper/", table, "/", arm, "/", keys[r], "/", column.title);
        const Episodes chosen = cell_episodes(r, column);
        filled.rows[r].cells.push_back(
            MakeCell(chosen, filled.rows[r].average, bootstrap_replicates, label));
        line.push_back(ContrastText(chosen, cell_episodes(r, columns[0]), bootstrap_replicates,
                                    label + " difference"));
      }
      if (&column != &columns.front()) filled.differences.push_back(line);
    }
    filled.groups.push_back(group);
  }
  AddPublished(published, keys, filled);
  MarkBest(filled);
  std::set<std::string> policies;
  for (const PiperEpisode& episode : episodes) policies.insert(episode.policy);
  filled.notes = {
      absl::StrCat("Paper: ", published.protocol, "."),
      absl::StrCat("Ours: Pipers emulated in MuJoCo with wear profiles new and used_one_year; a "
                   "scripted expert instead of teleoperation; policies ",
                   absl::StrJoin(policies, ", "), " in joint space, simulated time."),
      "No real arm was used. Differences pair episodes of equal task, object and initial state; p: "
      "McNemar's exact test, of single comparisons."};
  return filled;
}

}  // namespace robostress
