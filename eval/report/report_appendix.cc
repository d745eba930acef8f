#include "eval/report/report_appendix.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <set>
#include <tuple>

#include "absl/strings/escaping.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/suites.h"
#include "common/svg_plot.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

struct Film {
  const UnitResult* unit;
  std::string path;
  const EpisodeRow* episode;  // null when the name points to none
};

// Films of the same episode by different methods.
struct FilmGroup {
  const UnitConfig* config;  // of the first film
  std::vector<Film> films;
  std::string scene;  // suite, scenario, severity, policy, seed
  std::string name;   // the file's stem

  // Groups that show more come first: an outcome that differs, an adapter that has been updated.
  int Interest() const {
    bool success = false, failure = false, updated = false;
    for (const Film& film : films) {
      if (film.episode == nullptr) continue;
      (film.episode->success ? success : failure) = true;
      updated = updated || film.episode->updates > 0;
    }
    return 2 * (success && failure) + updated;
  }
  int Episode() const {
    return films.front().episode == nullptr ? 0 : films.front().episode->episode;
  }
};

// The integers in a file name, in order: task and episode.
std::vector<int> Numbers(const std::string& name) {
  std::vector<int> numbers;
  for (size_t i = 0; i < name.size();) {
    if (name[i] < '0' || name[i] > '9') {
      ++i;
      continue;
    }
    int value = 0;
    for (; i < name.size() && name[i] >= '0' && name[i] <= '9'; ++i)
      value = std::min(10 * value + (name[i] - '0'), 1000000);
    numbers.push_back(value);
  }
  return numbers;
}

const EpisodeRow* FindEpisode(const UnitResult& unit, const std::string& stem) {
  const std::vector<int> numbers = Numbers(stem);
  for (const EpisodeRow& row : unit.episodes) {
    if (numbers.size() >= 2 && row.task == numbers[0] && row.episode == numbers[1]) return &row;
  }
  return nullptr;
}

std::vector<FilmGroup> GroupFilms(const RunData& run) {
  std::vector<FilmGroup> groups;
  for (const UnitResult& unit : run.units) {
    const UnitConfig& c = unit.config;
    const std::string scene =
        absl::StrCat(c.suite, "|", c.scenario, "|", c.severity, "|", c.policy, "|", c.seed);
    for (const std::string& path : unit.videos) {
      const std::string name = fs::path(path).stem().string();
      auto group = std::find_if(groups.begin(), groups.end(), [&](const FilmGroup& g) {
        return g.scene == scene && g.name == name;
      });
      if (group == groups.end()) group = groups.insert(groups.end(), {&c, {}, scene, name});
      group->films.push_back({&unit, path, FindEpisode(unit, name)});
    }
  }
  return groups;
}

// Ranks each group within its scene, best first, and orders by rank: every scene shows its best
// before any shows its second.
std::vector<const FilmGroup*> ByInterest(const std::vector<FilmGroup>& groups) {
  std::map<std::string, std::vector<const FilmGroup*>> scenes;
  for (const FilmGroup& group : groups) scenes[group.scene].push_back(&group);
  std::map<const FilmGroup*, size_t> rank;
  std::vector<const FilmGroup*> ordered;
  for (auto& [scene, of_scene] : scenes) {
    std::stable_sort(of_scene.begin(), of_scene.end(), [](const FilmGroup* a, const FilmGroup* b) {
      return std::pair(a->Interest(), a->Episode()) > std::pair(b->Interest(), b->Episode());
    });
    for (size_t i = 0; i < of_scene.size(); ++i) rank[of_scene[i]] = i;
  }
  for (const FilmGroup& group : groups) ordered.push_back(&group);
  std::stable_sort(ordered.begin(), ordered.end(),
                   [&](const FilmGroup* a, const FilmGroup* b) { return rank[a] < rank[b]; });
  return ordered;
}

// "success after 143 steps, 21 updates so far"
std::string OutcomeText(const Film& film) {
  if (film.episode == nullptr) return "";
  const std::string updates = film.unit->config.method->adapts()
                                  ? absl::StrCat(", ", film.episode->updates, " updates so far")
                                  : "";
  return absl::StrCat(film.episode->success ? "success" : "failure", " after ", film.episode->steps,
                      " steps", updates);
}

std::string Figure(const Film& film, const std::string& bytes) {
  const std::string method = film.unit->config.method->method;
  return absl::StrCat("<figure><img alt=\"rollout\" src=\"data:image/webp;base64,",
                      absl::Base64Escape(bytes),
                      "\"><figcaption><span class=dot style=\"background:", MethodColor(method),
                      "\"></span><b>", EscapeXml(MethodTitle(method)), "</b> ",
                      EscapeXml(OutcomeText(film)), "</figcaption></figure>");
}

std::string Row(const std::string& name, const std::string& value) {
  return value.empty() ? ""
                       : absl::StrCat("<tr><td>", EscapeXml(name),
                                      "</td><td style=\"text-align:left;white-space:normal\">",
                                      EscapeXml(value), "</td></tr>\n");
}

// Where the time of an episode goes, per method; empty when nothing was timed.
std::string TimingTable(const RunData& run) {
  struct Row {
    TimingSums sums;
    int64_t steps = 0, chunks = 0;
  };
  std::map<std::string, Row> rows;
  for (const UnitResult& unit : run.units) {
    if (unit.timing.episodes != static_cast<int>(unit.episodes.size())) continue;
    Row& row = rows[unit.config.method->method];
    row.sums.episodes += unit.timing.episodes;
    row.sums.wall_s += unit.timing.wall_s;
    row.sums.predict_s += unit.timing.predict_s;
    row.sums.step_s += unit.timing.step_s;
    row.sums.observe_s += unit.timing.observe_s;
    row.sums.feedback_s += unit.timing.feedback_s;
    for (const EpisodeRow& episode : unit.episodes) {
      row.steps += episode.steps;
      row.chunks += episode.chunks;
    }
  }
  std::string html;
  for (const std::string& method : MethodNames()) {
    const auto found = rows.find(method);
    if (found == rows.end() || found->second.steps == 0 || found->second.chunks == 0) continue;
    const Row& row = found->second;
    absl::StrAppendFormat(
        &html,
        "<tr><td>%s</td><td>%.2f</td><td>%.2f</td><td>%.1f</td><td>%.1f</td><td>%.1f</td></tr>\n",
        EscapeXml(MethodTitle(method)), row.sums.wall_s / row.sums.episodes,
        1e3 * row.sums.step_s / row.steps, 1e3 * row.sums.observe_s / row.chunks,
        1e3 * row.sums.predict_s / row.chunks, 1e3 * row.sums.feedback_s / row.chunks);
  }
  if (html.empty()) return "";
  return "<h3>Wall time on this machine, workers and server sharing its "
         "cores</h3><table><tr><th>Method</th><th>s per episode</th>"
         "<th>ms per control step</th><th>ms per observation</th><th>ms per prediction</th><th>ms "
         "per feedback</th></tr>\n" +
         html + "</table>\n";
}

std::string EnvironmentTable(const nlohmann::json& environment) {
  if (!environment.is_object())
    return "<p class=note>environment.json is missing: versions were not recorded.</p>\n";
  std::string html = "<table><tr><th>Recorded</th><th style=\"text-align:left\">Value</th></tr>\n";
  for (const auto& [name, value] : environment.items()) {
    if (value.is_object()) {
      for (const auto& [file, hash] : value.items())
        absl::StrAppend(&html, Row(absl::StrCat(name, " ", file),
                                   hash.is_string() ? hash.get<std::string>() : hash.dump()));
    } else {
      absl::StrAppend(&html,
                      Row(name, value.is_string() ? value.get<std::string>() : value.dump()));
    }
  }
  return html + "</table>\n";
}

}  // namespace

std::string VideoSection(const RunData& run, const ReportOptions& options) {
  const std::vector<FilmGroup> groups = GroupFilms(run);
  if (groups.empty() || options.max_videos == 0) return "";
  std::map<const FilmGroup*, std::string> chosen;  // -> figures
  int shown = 0, left_out = 0;
  double megabytes = 0;
  for (const FilmGroup* group : ByInterest(groups)) {
    const int count = static_cast<int>(group->films.size());
    std::string figures;
    double size = 0;
    for (const Film& film : group->films) {
      const absl::StatusOr<std::string> bytes = ReadFile(film.path);
      if (!bytes.ok()) continue;
      size += bytes->size() / 1e6;
      absl::StrAppend(&figures, Figure(film, *bytes));
    }
    if (shown + count > options.max_videos || megabytes + size > options.max_video_mb) {
      left_out += count;
      continue;
    }
    shown += count;
    megabytes += size;
    chosen.emplace(group, std::move(figures));
  }
  std::string html =
      "<h2 id=videos>Rollouts side by side</h2>\n<p class=note>Same task, same initial state, same "
      "sampling noise: the "
      "methods differ, nothing else. Chosen for difference: pairs whose outcomes differ come "
      "first, so these films "
      "are no sample of the success rates.</p>\n<div class=videos>\n";
  for (const FilmGroup& group : groups) {
    const auto figures = chosen.find(&group);
    if (figures == chosen.end()) continue;
    const SuiteInfo* suite = FindSuite(group.config->suite);
    const EpisodeRow* episode = group.films.front().episode;
    absl::StrAppend(&html, "<div class=pair><h3 style=\"margin-top:0\">",
                    EscapeXml(ScenarioTitle(group.config->scenario)), " <small class=paper>",
                    EscapeXml(suite == nullptr ? group.config->suite : suite->title),
                    episode == nullptr
                        ? ""
                        : absl::StrCat(", task ", episode->task, ", episode ", episode->episode),
                    ", L", group.config->severity, "</small></h3><div class=row>", figures->second,
                    "</div></div>\n");
  }
  html += "</div>\n";
  if (left_out > 0) {
    absl::StrAppend(&html, "<p class=note>", left_out,
                    " more films are in units/*/videos; --max-videos and --max-video-mb let more "
                    "into the page.</p>\n");
  }
  return html;
}

std::string SetupSection(const RunData& run) {
  std::string html = "<h2 id=setup>Setup and versions</h2>\n";
  absl::StrAppend(&html, EnvironmentTable(run.environment), TimingTable(run));
  if (const absl::StatusOr<std::string> grid = ReadFile(run.dir + "/sweep.yaml"); grid.ok()) {
    absl::StrAppend(&html,
                    "<p>To repeat: <code>robostress sweep --grid sweep.yaml --out DIR</code> with "
                    "this grid (the last one run in the directory):</p><pre>",
                    EscapeXml(*grid), "</pre>\n");
  }
  std::set<std::string> models;
  for (const UnitResult& unit : run.units) {
    if (unit.provenance.is_object()) models.insert(unit.provenance.dump());
  }
  for (const std::string& model : models) {
    absl::StrAppend(&html, "<p class=note>Units were run with <code>", EscapeXml(model),
                    "</code></p>\n");
  }
  std::set<std::string> shown;
  for (const UnitResult& unit : run.units) {
    if (!shown.insert(unit.config.method->method).second) continue;
    absl::StrAppend(&html, "<details><summary>Resolved configuration of ", EscapeXml(unit.id),
                    "</summary><pre>", EscapeXml(DumpConfig(unit.config)), "</pre></details>\n");
  }
  return html;
}

std::string LimitsSection(const RunData& run, const Summary& summary, const SuccessTable& main) {
  int clusters = 0;
  const char* noun = "";
  for (const auto& [method, average] : main.averages) {
    if (average.n == 0 || (clusters > 0 && average.success.clusters >= clusters)) continue;
    clusters = average.success.clusters;
    noun = ClusterNoun(average.clustering);
  }
  std::set<int64_t> seeds;
  bool embedded = false, dev_states = false;
  std::set<std::string> not_adapted;
  for (const UnitResult& unit : run.units) {
    seeds.insert(unit.config.seed);
    const SuiteInfo* suite = FindSuite(unit.config.suite);
    embedded = embedded || (suite != nullptr && !suite->needs_libero);
    dev_states = dev_states || unit.config.first_initial_state + unit.config.episodes > 20;
    if (unit.config.method->adapts() &&
        (unit.episodes.empty() || unit.episodes.back().updates == 0))
      not_adapted.insert(unit.id);
  }
  std::string html = "<h2 id=limits>Limits</h2>\n<ul>\n";
  if (clusters > 0 && clusters < 40) {
    absl::StrAppend(&html, "<li>", clusters, " ", noun,
                    " as clusters: bootstrap intervals from so few tend to be too "
                    "narrow. Read this as a demonstration, not as a measurement.</li>\n");
  }
  html +=
      "<li>Episodes of an adapting method are not independent: the adapter is carried across them. "
      "Wilson intervals ignore this, and the bootstrap resamples "
      "tasks, not whole adaptation histories; other orders of the same episodes would "
      "give other numbers.</li>\n";
  html +=
      "<li>A single difference says little: the null control (same weights, other sampling noise) "
      "shows how many outcomes flip by chance, and the gain control what a constant factor does. "
      "Compare with them before calling a difference an effect of adaptation.</li>\n";
  if (seeds.size() == 1) html += "<li>One seed of the sampling noise.</li>\n";
  if (summary.tables.size() > 1)
    html +=
        "<li>Holm's correction is made within each table; that there are several tables on this "
        "page is not corrected for.</li>\n";
  if (embedded) {
    html +=
        "<li>The embedded suites are made of primitives and the embedded policy is small and "
        "trained on them. They follow LIBERO's ideas, and their numbers are not LIBERO's.</li>\n";
  }
  if (dev_states)
    html += "<li>Some episodes start from states beyond 0-19, the reporting split.</li>\n";
  if (!not_adapted.empty()) {
    absl::StrAppend(&html, "<li>", not_adapted.size(),
                    " units of adapting methods never applied an update (their buffer never "
                    "filled) and count as base: ",
                    EscapeXml(absl::StrJoin(not_adapted, ", ")), ".</li>\n");
  }
  html +=
      "<li>Execution errors are models of friction, gravity compensation, backlash and compliance "
      "at nominal parameters; no real robot was measured for this page.</li>\n";
  return html + "</ul>\n";
}

}  // namespace robostress
