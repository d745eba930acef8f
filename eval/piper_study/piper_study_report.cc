#include "eval/piper_study/piper_study_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <set>
#include <tuple>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/records/arm_episode.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "eval/report/text_table.h"
#include "eval/statistics/episode_bootstrap.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;
using Episodes = std::vector<PiperStudyEpisode>;

constexpr int kReplicates = 4000;

Episodes Where(const Episodes& all, const std::function<bool(const PiperStudyEpisode&)>& of) {
  Episodes some;
  std::copy_if(all.begin(), all.end(), std::back_inserter(some), of);
  return some;
}

absl::StatusOr<PiperStudyEpisode> ParseRow(const PiperUnit& unit, const std::string& where,
                                           const std::string& line) {
  RS_ASSIGN_OR_RETURN(const ArmEpisode row, ParseArmEpisode(where, line));
  const auto damaged = [&](const char* field) {
    return absl::DataLossError(absl::StrCat(where, ": ", field,
                                            " is missing; remove the unit's folder and run the "
                                            "stage again"));
  };
  if (!row.variant) return damaged("variant");
  if (!row.success) return damaged("success");
  if (!row.instruction) return damaged("instruction");
  const auto at = std::find(std::begin(kPiperVariants), std::end(kPiperVariants), *row.variant);
  if (at == std::end(kPiperVariants)) return damaged("a known variant");
  PiperStudyEpisode episode;
  episode.unit = unit;
  episode.variant = static_cast<int>(at - std::begin(kPiperVariants));
  episode.success = *row.success;
  episode.instruction = *row.instruction;
  episode.episode = row.episode;
  episode.residual = row.residual;
  episode.eta_sq = row.eta_sq.value_or(0);
  episode.displacement_sq = row.displacement_sq.value_or(0);
  episode.updates = static_cast<int64_t>(row.adapter_version);
  episode.steps = static_cast<int64_t>(row.steps);
  episode.steps_masked = static_cast<int64_t>(row.steps_masked);
  episode.power_cycles = row.power_cycles.value_or(0);
  episode.seconds = row.seconds;
  return episode;
}

std::string CellText(const PiperCell& cell) {
  if (cell.n == 0) return "-";
  std::string text = absl::StrFormat("%d/%d [%.0f, %.0f]", cell.successes, cell.n,
                                     100 * cell.wilson.low, 100 * cell.wilson.high);
  if (cell.paired) {
    const Interval& interval = cell.versus_base.interval;
    absl::StrAppendFormat(&text, "; %+.0f", 100 * cell.versus_base.estimate);
    if (std::isfinite(interval.low))  // one initial state has none
      absl::StrAppendFormat(&text, " [%+.0f, %+.0f]", 100 * interval.low, 100 * interval.high);
  }
  if (cell.updates > 0) absl::StrAppendFormat(&text, "; %d updates", cell.updates);
  return text;
}

Json CellJson(const PiperCell& cell) {
  Json json = {{"n", cell.n},
               {"successes", cell.successes},
               {"wilson", {cell.wilson.low, cell.wilson.high}},
               {"residual", cell.residual},
               {"updates", cell.updates}};
  if (cell.paired) {
    json["minus_base"] = cell.versus_base.estimate;
    json["interval"] = Json::array();
    for (const double end : {cell.versus_base.interval.low, cell.versus_base.interval.high})
      json["interval"].push_back(std::isfinite(end) ? Json(end) : Json(nullptr));
    json["won"] = cell.plus;
    json["lost"] = cell.minus;
  }
  return json;
}

std::string Csv(const Episodes& episodes) {
  std::string csv =
      "arm,policy,method,task,variant,episode,success,residual,updates,steps,steps_masked,"
      "power_cycles,experiment\n";
  for (const PiperStudyEpisode& e : episodes) {
    absl::StrAppendFormat(&csv, "%s,nano,%s,%d,%d,%d,%d,%.6f,%d,%d,%d,%d,%s\n", e.unit.arm,
                          e.unit.method, e.unit.task, e.variant, e.episode, e.success ? 1 : 0,
                          e.residual, e.updates, e.steps, e.steps_masked, e.power_cycles,
                          e.unit.experiment);
  }
  return csv;
}

// One table: a row for every key of `rows`, a column for every method.
struct Row {
  std::string title;
  Episodes episodes;
};
void AddTable(const std::string& title, const std::vector<Row>& rows,
              const std::vector<std::string>& methods, std::string& text, Json& json) {
  TextRows cells = {{""}};
  for (const std::string& method : methods) cells[0].push_back(method);
  Json table = Json::array();
  for (const Row& row : rows) {
    cells.push_back({row.title});
    Json line = {{"row", row.title}};
    for (const std::string& method : methods) {
      const PiperCell cell = MakePiperCell(row.episodes, method, title + row.title);
      cells.back().push_back(CellText(cell));
      if (cell.n > 0) line[method] = CellJson(cell);
    }
    table.push_back(std::move(line));
  }
  absl::StrAppend(&text, "**", title, "**\n\n", MarkdownTable(cells), "\n");
  json[title] = std::move(table);
}

}  // namespace

absl::StatusOr<std::vector<PiperStudyEpisode>> ReadPiperStudy(const std::vector<PiperUnit>& units,
                                                              const std::string& folder) {
  std::vector<PiperStudyEpisode> episodes;
  for (const PiperUnit& unit : units) {
    const std::string unit_folder = absl::StrCat(folder, "/", unit.id);
    if (!fs::exists(unit_folder + "/DONE")) continue;
    const std::string file = unit_folder + "/episodes.jsonl";
    RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
    int number = 0;
    for (const std::string& line :
         std::vector<std::string>(absl::StrSplit(text, '\n', absl::SkipEmpty()))) {
      RS_ASSIGN_OR_RETURN(PiperStudyEpisode episode,
                          ParseRow(unit, absl::StrCat(file, ":", ++number), line));
      episodes.push_back(std::move(episode));
    }
  }
  return episodes;
}

PiperCell MakePiperCell(const std::vector<PiperStudyEpisode>& episodes, const std::string& method,
                        const std::string& label) {
  using Key = std::tuple<std::string, int, int, int>;
  const auto key = [](const PiperStudyEpisode& e) {
    return Key{e.unit.arm, e.unit.task, e.variant, e.episode};
  };
  std::map<Key, bool> base;
  for (const PiperStudyEpisode& e : episodes) {
    if (e.unit.method == "base") base[key(e)] = e.success;
  }
  PiperCell cell;
  std::vector<EpisodeValue> differences;
  std::map<std::string, int64_t> updates;  // by unit
  for (const PiperStudyEpisode& e : episodes) {
    if (e.unit.method != method) continue;
    ++cell.n;
    cell.successes += e.success;
    cell.residual += e.residual;
    updates[e.unit.id] = std::max(updates[e.unit.id], e.updates);
    const auto same = base.find(key(e));
    if (method == "base" || same == base.end()) continue;
    const int difference = static_cast<int>(e.success) - static_cast<int>(same->second);
    cell.plus += difference > 0;
    cell.minus += difference < 0;
    // One cluster: the same initial state of a task, on every arm and with every variant.
    differences.push_back({"piper", e.unit.task, e.episode, 0, static_cast<double>(difference)});
  }
  if (cell.n == 0) return cell;
  cell.residual /= cell.n;
  cell.wilson = WilsonInterval(cell.successes, cell.n);
  for (const auto& [id, count] : updates) cell.updates += count;
  cell.paired = !differences.empty();
  if (cell.paired)
    cell.versus_base = BootstrapEpisodes(differences, kReplicates, absl::StrCat(label, method));
  return cell;
}

absl::StatusOr<std::vector<std::string>> UnknownWords(const std::string& weights,
                                                      const std::string& instruction) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(weights));
  const auto found = file.metadata().find("vocabulary");
  if (found == file.metadata().end())
    return absl::InvalidArgumentError(absl::StrCat(weights, ": has no vocabulary of words"));
  const std::set<std::string> known = absl::StrSplit(found->second, ' ', absl::SkipEmpty());
  std::vector<std::string> unknown;
  const auto note = [&](std::string word) {
    while (!word.empty() && word.back() == '-') word.pop_back();
    if (word.empty() || known.count(word) > 0) return;
    if (std::find(unknown.begin(), unknown.end(), word) == unknown.end()) unknown.push_back(word);
  };
  // As the policy splits an instruction: letters, digits and inner hyphens.
  std::string word;
  for (const char c : instruction) {
    if (absl::ascii_isalnum(c) || (c == '-' && !word.empty())) {
      word.push_back(absl::ascii_tolower(c));
    } else {
      note(std::exchange(word, ""));
    }
  }
  note(word);
  return unknown;
}

absl::Status WritePiperReport(const PiperStudyOptions& options, const std::vector<PiperUnit>& units,
                              const std::string& out, const std::string& kind,
                              const std::string& weights) {
  RS_ASSIGN_OR_RETURN(const Episodes all, ReadPiperStudy(units, absl::StrCat(out, "/", kind)));
  if (all.empty())
    return absl::NotFoundError(absl::StrCat(out, "/", kind,
                                            " holds no finished unit; run the stage "
                                            "evaluate first"));
  std::set<std::string> finished;
  for (const PiperStudyEpisode& e : all) finished.insert(e.unit.id);
  std::string text = absl::StrFormat(
      "%d of %d units, %d episodes, %s. Successes of episodes with Wilson's 95 %% interval [%%]; "
      "then the difference to base on the same initial states in points with its 95 %% interval "
      "(bootstrap over initial states); then updates applied.\n\n",
      finished.size(), units.size(), all.size(),
      kind == "live" ? "real time over UDP" : "simulated time");
  Json json = {{"units", units.size()}, {"finished", finished.size()}, {"episodes", all.size()}};

  std::vector<Row> rows;
  for (const std::string& arm : options.arms) {
    for (const int task : options.tasks) {
      rows.push_back({absl::StrCat(arm, ", task ", task, " ", kPiperTasks[task - 1]),
                      Where(all, [&](const PiperStudyEpisode& e) {
                        return e.unit.experiment == "main" && e.unit.arm == arm &&
                               e.unit.task == task;
                      })});
    }
    rows.push_back({absl::StrCat(arm, ", all"), Where(all, [&](const PiperStudyEpisode& e) {
                      return e.unit.experiment == "main" && e.unit.arm == arm;
                    })});
  }
  AddTable("Two arms, four tasks", rows, {"base", "robust", "ours"}, text, json);
  const std::string& arm = options.arms[0];
  AddTable("Disturbance observer",
           {{absl::StrCat(arm, ", task ", options.tasks[0]),
             Where(all,
                   [&](const PiperStudyEpisode& e) {
                     return e.unit.experiment != "unseen" && e.unit.arm == arm &&
                            e.unit.task == options.tasks[0];
                   })}},
           {"base", "dob", "ours", "dob_ours"}, text, json);
  rows.clear();
  for (int variant = 1; variant < 6; ++variant) {
    rows.push_back({kPiperVariants[variant], Where(all, [&](const PiperStudyEpisode& e) {
                      return e.unit.experiment == "unseen" && e.variant == variant;
                    })});
  }
  rows.push_back({"all variants", Where(all, [&](const PiperStudyEpisode& e) {
                    return e.unit.experiment == "unseen";
                  })});
  AddTable("Objects unseen in training", rows, {"base", "robust", "ours"}, text, json);

  TextRows residuals = {{"arm", "episodes of base", "residual, mean"}};
  for (const std::string& name : options.arms) {
    const PiperCell cell =
        MakePiperCell(Where(all,
                            [&](const PiperStudyEpisode& e) {
                              return e.unit.experiment == "main" && e.unit.arm == name;
                            }),
                      "base", "residual");
    if (cell.n == 0) continue;
    residuals.push_back(
        {name, absl::StrCat(cell.n), absl::StrFormat("%.1f %%", 100 * cell.residual)});
    json["residual"][name] = cell.residual;
  }
  absl::StrAppend(&text, "**Residual in joint space**\n\n", MarkdownTable(residuals), "\n");
  std::map<int, std::string> told;  // by variant
  for (const PiperStudyEpisode& e : all) {
    if (e.variant > 0) told[e.variant] = e.instruction;
  }
  for (const auto& [variant, instruction] : told) {
    if (!fs::exists(weights)) break;
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> unknown, UnknownWords(weights, instruction));
    absl::StrAppend(&text, "\"", instruction, "\": ",
                    unknown.empty()
                        ? "no unknown word"
                        : absl::StrCat("unknown to the policy: ", absl::StrJoin(unknown, ", ")),
                    "\n\n");
    json["unknown_words"][kPiperVariants[variant]] = unknown;
  }
  RS_RETURN_IF_ERROR(WriteFileAtomically(out + "/episodes.csv", Csv(all)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(out + "/report.json", json.dump(2) + "\n"));
  RS_RETURN_IF_ERROR(WriteFileAtomically(out + "/report.md", text));
  std::printf("%s\n%s/report.md, report.json, episodes.csv\n", text.c_str(), out.c_str());
  return absl::OkStatus();
}

}  // namespace robostress
