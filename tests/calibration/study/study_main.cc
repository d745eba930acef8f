// calibration_study: how often robostress-calibrate says what is true, on rigs that
// calibration_generate makes.
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <map>
#include <optional>
#include <set>
#include <thread>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/command_line.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/program_folder.h"
#include "common/run_main.h"
#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/study/judge.h"
#include "tests/calibration/study/threshold_rates.h"
#include "tests/run_program.h"

namespace robostress::generator {
namespace {

using Json = nlohmann::json;

struct CommandLine {
  std::string out, calibrate, excite, motion, family = "any";
  double motion_s = 20;
  int rounds = 1;
  std::vector<std::string> kinds;
  std::vector<std::string> sizes = {"medium"};
  int first_seed = 1, seeds = 4, none = 0, workers = 2, surrogates = 199;
  bool table_only = false, follow = false;
};

// One rig of the study; kind: names joined by "+", or by "&" on different joints of an arm, or
// "none"; behind "@" a hardship.
struct Case {
  std::string kind, size, folder;
  uint64_t seed = 0;
};

std::vector<Case> Cases(const CommandLine& line) {
  std::vector<Case> cases;
  const auto add = [&](const std::string& kind, const std::string& size, int seed) {
    cases.push_back({kind, size, absl::StrCat(line.out, "/", kind, ".", size, ".", seed),
                     static_cast<uint64_t>(seed)});
  };
  // Seed by seed, so that a study that is stopped has something of every kind.
  for (int i = 0; i < std::max(line.seeds, line.none); ++i) {
    if (i < line.none) add("none", "medium", line.first_seed + i);
    for (const std::string& kind : line.kinds)
      for (const std::string& size : line.sizes)
        if (i < line.seeds) add(kind, size, line.first_seed + i);
  }
  return cases;
}

absl::StatusOr<Json> ReadJson(const std::string& file) {
  const auto text = ReadFile(file);
  if (!text.ok()) return text.status();
  const Json json = Json::parse(*text, nullptr, false);
  if (json.is_discarded()) return absl::InvalidArgumentError(file + ": no JSON");
  return json;
}

// Of those that some machine of the generator shows together.
std::vector<std::string> MimicPairs() {
  std::set<std::string> pairs;
  const auto drawn = [](const std::string& type) {
    return std::find(LibraryEffects().begin(), LibraryEffects().end(), type) !=
           LibraryEffects().end();
  };
  for (const EffectInfo& effect : EffectLibrary()) {
    for (const std::string& mimic : effect.mimics) {
      if (!drawn(effect.type) || !drawn(mimic)) continue;
      const std::vector<Family> one = FamiliesOf(effect.type), other = FamiliesOf(mimic);
      if (std::any_of(one.begin(), one.end(), [&](Family family) {
            return std::find(other.begin(), other.end(), family) != other.end();
          }))
        pairs.insert(absl::StrCat(std::min(effect.type, mimic), "+", std::max(effect.type, mimic)));
    }
  }
  return {pairs.begin(), pairs.end()};
}

absl::StatusOr<RigOptions> OptionsOf(const Case& c, const CommandLine& line) {
  RigOptions options;
  const std::vector<std::string> parts = absl::StrSplit(c.kind, '@');
  if (parts[0] != "none") options.effects = absl::StrSplit(parts[0], absl::ByAnyChar("+&"));
  options.apart = absl::StrContains(parts[0], '&');
  if (parts.size() > 1) {
    const absl::StatusOr<Hardship> hardship = ParseHardship(parts[1]);
    if (!hardship.ok()) return hardship.status();
    options.hardship = *hardship;
  }
  options.size = c.size == "small"   ? Size::kSmall
                 : c.size == "large" ? Size::kLarge
                                     : Size::kMedium;
  options.seed = c.seed;
  const absl::StatusOr<Family> family = ParseFamily(options.apart ? "arm" : line.family);
  if (!family.ok()) return family.status();
  options.family = *family;
  return options;
}

// Writes the rig, lets the program judge it, and leaves said.txt in `folder`.
absl::Status RunRig(const RigOptions& options, const std::string& folder, const CommandLine& line) {
  const std::string rig = folder + "/rig", report = folder + "/report";
  if (std::filesystem::exists(folder + "/said.txt")) return absl::OkStatus();
  const auto generated = GenerateRig(options);
  if (!generated.ok()) return generated.status();
  if (absl::Status written = WriteGeneratedRig(*generated, options, rig); !written.ok())
    return written;
  const auto begin = std::chrono::steady_clock::now();
  const auto [output, code] =
      RunProgram(line.calibrate, absl::StrCat("--rig '", rig, "/rig.yaml' --out '", report,
                                              "' --quiet --surrogates ", line.surrogates));
  const std::chrono::duration<double> taken = std::chrono::steady_clock::now() - begin;
  if (absl::Status status =
          WriteFileAtomically(folder + "/seconds.txt", absl::StrFormat("%.2f\n", taken.count()));
      !status.ok())
    return status;
  // Last: a case that has it is done.
  return WriteFileAtomically(folder + "/said.txt", absl::StrCat("exit ", code, "\n", output));
}

// Limits of a motion, as flags of `robostress excite`: within the way and the speed of what was
// drawn, swings of half the way, and the acceleration of a sine that has both.
std::string LimitsOf(const GeneratedRig& drawn) {
  std::string limits;
  double fastest = drawn.rate_hz / 10;
  for (size_t j = 0; j < drawn.declared.drives.size(); ++j) {
    double low = 1e9, high = -1e9, speed = 0;
    for (const GeneratedRig::Log& log : drawn.logs) {
      if (log.role != "fit") continue;
      const JointChannels& channels = log.recording.joints[j];
      const bool commanded = drawn.family == Family::kServo || drawn.family == Family::kArm ||
                             drawn.family == Family::kSlide;
      const std::vector<double>& q = commanded ? channels.command : channels.clean;
      for (size_t k = 0; k < q.size(); ++k) {
        low = std::min(low, q[k]), high = std::max(high, q[k]);
        if (k > 0) speed = std::max(speed, std::abs(q[k] - q[k - 1]) * drawn.rate_hz);
      }
    }
    const double swing = (high - low) / 2;
    fastest = std::min(fastest, speed / (M_PI * swing));
    const std::string& name = drawn.joint_names[j];
    absl::StrAppendFormat(&limits,
                          " --swing %s=%.6g --velocity %s=%.6g --acceleration %s=%.6g --centre "
                          "%s=%.6g",
                          name, swing, name, speed, name, speed * speed / swing, name,
                          (high + low) / 2);
  }
  return absl::StrFormat("%s --fastest %.6g", limits, fastest);
}

// What `robostress excite` writes with these flags: MOTION.csv and MOTION.json in `folder`.
absl::StatusOr<PlayedRun> Excite(const std::string& flags, const std::string& folder,
                                 const CommandLine& line) {
  const std::string file = folder + "/motion";
  const auto [output, code] =
      RunProgram(line.excite, absl::StrCat("--without-shapes --out '", file, ".csv' --report '",
                                           file, ".json' --seconds ", line.motion_s, flags));
  if (code != 0) return absl::InternalError(output);
  const auto text = ReadFile(file + ".csv");
  if (!text.ok()) return text.status();
  const auto report = ReadJson(file + ".json");
  if (!report.ok()) return report.status();
  PlayedRun run;
  const std::vector<std::string> rows = absl::StrSplit(*text, '\n', absl::SkipEmpty());
  for (size_t row = 1; row < rows.size(); ++row) {
    const std::vector<std::string> fields = absl::StrSplit(rows[row], ',');
    run.q.resize(fields.size() - 1);
    for (size_t j = 0; j < run.q.size(); ++j) run.q[j].push_back(std::stod(fields[j + 1]));
  }
  run.gain = (*report).value("gain", 1.0);
  run.mass = (*report).value("mass_kg", 0.0);
  return run;
}

std::string FolderOf(const Case& c, int round) {
  return round == 0 ? c.folder : absl::StrCat(c.folder, "/round_", round + 1);
}

// The verdict on one designed motion, and on more of them as long as something is open.
absl::Status RunRounds(RigOptions options, const Case& c, const CommandLine& line) {
  const std::string drawn_folder = c.folder + "/drawn";
  const auto drawn = GenerateRig(options);
  if (!drawn.ok()) return drawn.status();
  if (absl::Status written = WriteGeneratedRig(*drawn, options, drawn_folder); !written.ok())
    return written;
  const std::string limits = LimitsOf(*drawn);
  std::string rig = drawn_folder, after;
  for (int round = 0; round < line.rounds; ++round) {
    const std::string folder = FolderOf(c, round);
    if (absl::Status made = MakeDirectories(folder); !made.ok()) return made;
    auto run = Excite(absl::StrCat(" --rig '", rig, "/rig.yaml'", limits,
                                   line.motion == "sweep" ? " --sweep" : "", after),
                      folder, line);
    if (!run.ok()) return run.status();
    options.played.push_back(*std::move(run));
    if (absl::Status status = RunRig(options, folder, line); !status.ok()) return status;
    const auto report = ReadJson(folder + "/report/report.json");
    if (!report.ok()) return absl::OkStatus();
    const std::string verdict = (*report).value("verdict", "");
    if (verdict == "attributed" || verdict == "declared_sufficient") return absl::OkStatus();
    rig = folder + "/rig";
    after = absl::StrCat(" --after '", folder, "/report'");
  }
  return absl::OkStatus();
}

// The run that an ambiguous verdict asks for, if the generator can make it.
std::optional<ProposedRun> ProposedBy(const Json& report) {
  for (const Json& joint : report["joints"]) {
    const Json& next = joint["next_experiment"];
    if (joint["verdict"] != "ambiguous" || next.value("apart", 0.0) <= 0) continue;
    const Json& change = next["change"];
    if (change.value("load", 0.0) != 0) continue;
    const std::string log = std::filesystem::path(next["log"].get<std::string>()).stem();
    ProposedRun run{0, change["speed"], change["size"], change["servo_gain"], change["mass_kg"]};
    if (absl::SimpleAtoi(absl::StripPrefix(log, "log_"), &run.log)) return run;
  }
  return {};
}

absl::Status RunCase(const Case& c, const CommandLine& line) {
  absl::StatusOr<RigOptions> options = OptionsOf(c, line);
  if (!options.ok()) return options.status();
  if (!line.motion.empty()) {
    if (std::filesystem::exists(c.folder + "/done")) return absl::OkStatus();
    const absl::Status status = RunRounds(*options, c, line);
    return status.ok() ? WriteFileAtomically(c.folder + "/done", "") : status;
  }
  if (absl::Status status = RunRig(*options, c.folder, line); !status.ok() || !line.follow)
    return status;
  const auto report = ReadJson(c.folder + "/report/report.json");
  if (!report.ok()) return absl::OkStatus();
  options->proposed = ProposedBy(*report);
  return options->proposed ? RunRig(*options, c.folder + "/followed", line) : absl::OkStatus();
}

// The newest report of `rounds` motions at most.
absl::StatusOr<Json> ReportOf(const Case& c, int rounds) {
  absl::StatusOr<Json> report = ReadJson(FolderOf(c, 0) + "/report/report.json");
  for (int round = 1; round < rounds && report.ok(); ++round) {
    auto next = ReadJson(FolderOf(c, round) + "/report/report.json");
    if (!next.ok()) break;
    report = std::move(next);
  }
  return report;
}

// What became of ambiguous verdicts after the run that they asked for.
struct Followed {
  int runs = 0, named = 0, smaller = 0, wrong = 0;
  void Add(const Case& c, const Json& before, const Json& truth) {
    const auto after = ReadJson(c.folder + "/followed/report/report.json");
    if (!after.ok()) return;
    ++runs;
    const Outcome outcome = Judge(*after, truth).outcome;
    named += outcome == Outcome::kNamed;
    smaller += outcome == Outcome::kGrouped && Members(*after) < Members(before);
    wrong += outcome == Outcome::kWrong || outcome == Outcome::kWrongGroup;
  }
  static size_t Members(const Json& report) {
    size_t members = 0;
    for (const Json& group : report["groups"]) members += group.size();
    return members;
  }
};

double SecondsOf(const Case& c) {
  std::ifstream file(c.folder + "/seconds.txt");
  double seconds = 0;
  file >> seconds;
  return seconds;
}

std::string Share(int count, int n) {
  const auto [low, high] = ClopperPearson(count, n);
  return absl::StrFormat("%d of %d, %.1f %% (95 %%: %.1f to %.1f %%)", count, n,
                         n > 0 ? 100.0 * count / n : 0, 100 * low, 100 * high);
}

// Markdown.
std::string Table(const std::vector<Case>& cases, int rounds) {
  constexpr Outcome kColumns[] = {Outcome::kNamed,      Outcome::kGrouped,  Outcome::kListed,
                                  Outcome::kHedged,     Outcome::kOneOfTwo, Outcome::kMissed,
                                  Outcome::kWrongGroup, Outcome::kWrong,    Outcome::kNothing,
                                  Outcome::kFalseAlarm, Outcome::kRefused};
  std::map<std::string, std::map<Outcome, int>> rows;
  std::map<Outcome, int> total;
  std::string listed;
  std::vector<double> seconds;
  int none = 0, alarms = 0, seen = 0, right = 0, all_hidden = 0;
  Followed followed;
  std::vector<int> named_after(rounds), told_wrongly_after(rounds);
  for (const Case& c : cases) {
    const auto truth = ReadJson(c.folder + "/rig/truth.json");
    if (!truth.ok() || !std::filesystem::exists(c.folder + "/said.txt")) continue;
    const auto report = ReportOf(c, rounds);
    const Judged judged = report.ok() ? Judge(*report, *truth) : Judged{};
    for (int round = 1; round <= rounds; ++round) {
      const auto until = ReportOf(c, round);
      const Outcome outcome = until.ok() ? Judge(*until, *truth).outcome : Outcome::kRefused;
      named_after[round - 1] += outcome == Outcome::kNamed;
      told_wrongly_after[round - 1] +=
          outcome == Outcome::kWrong || outcome == Outcome::kWrongGroup;
    }
    seconds.push_back(SecondsOf(c));
    if (report.ok()) followed.Add(c, *report, *truth);
    ++rows[c.kind][judged.outcome];
    ++total[judged.outcome];
    if ((*truth)["effects"].empty()) {
      ++none;
      alarms += judged.outcome == Outcome::kFalseAlarm;
    } else {
      ++all_hidden;
      const bool good = judged.outcome == Outcome::kNamed || judged.outcome == Outcome::kGrouped;
      right += good;
      seen += judged.outcome != Outcome::kMissed && judged.outcome != Outcome::kRefused;
    }
    switch (judged.outcome) {
      case Outcome::kNamed:
      case Outcome::kGrouped:
      case Outcome::kNothing:
        break;
      default:
        absl::StrAppendFormat(&listed, "| %s | %s %s %d | %s | %.3g | %s |\n",
                              OutcomeName(judged.outcome), c.kind, c.size, c.seed,
                              (*truth)["family"].get<std::string>(),
                              (*truth)["visibility"].get<double>(), judged.said);
    }
  }
  std::string text = "| hidden |";
  for (const Outcome o : kColumns) absl::StrAppend(&text, " ", OutcomeName(o), " |");
  text += "\n|---|";
  for (size_t i = 0; i < std::size(kColumns); ++i) text += "---|";
  text += "\n";
  for (auto& [kind, counts] : rows) {
    absl::StrAppend(&text, "| ", kind, " |");
    for (const Outcome o : kColumns)
      absl::StrAppend(&text, " ", counts[o] == 0 ? "" : absl::StrCat(counts[o]), " |");
    text += "\n";
  }
  text += "| **all** |";
  for (const Outcome o : kColumns) absl::StrAppend(&text, " ", total[o], " |");
  text += "\n\n";
  absl::StrAppend(&text, "Named or in the stated group: ", Share(right, all_hidden), "\n");
  if (const int one = total[Outcome::kOneOfTwo]; one > 0)
    absl::StrAppend(&text, "The same without pairs of which one effect explains all but noise: ",
                    Share(right, all_hidden - one), "\n");
  absl::StrAppend(&text, "Said that something is missing where it is: ", Share(seen, all_hidden),
                  "\n");
  absl::StrAppend(
      &text, "Attributed to what is not there: ", Share(total[Outcome::kWrong], all_hidden), "\n");
  absl::StrAppend(&text, "False alarms: ", Share(alarms, none), "\n");
  if (followed.runs > 0)
    absl::StrAppendFormat(
        &text,
        "Ambiguous, and then the run that the verdict asked for: %d; named after it "
        "%d, in a smaller group %d, told wrongly %d\n",
        followed.runs, followed.named, followed.smaller, followed.wrong);
  for (int round = 1; round <= rounds && rounds > 1; ++round)
    absl::StrAppendFormat(&text, "After %d motions at most: named %d, told wrongly %d, of %d\n",
                          round, named_after[round - 1], told_wrongly_after[round - 1], all_hidden);
  if (!seconds.empty()) {
    std::sort(seconds.begin(), seconds.end());
    absl::StrAppendFormat(&text, "Seconds per trace: median %.1f, largest %.1f\n",
                          seconds[seconds.size() / 2], seconds.back());
  }
  absl::StrAppend(&text, "\n| outcome | hidden, size, seed | family | visibility | said |\n",
                  "|---|---|---|---|---|\n", listed);
  return text;
}

// Of every finished rig in the folders, whatever study it belongs to.
std::string RatesOf(const std::vector<std::string>& folders) {
  std::vector<Traced> rigs;
  for (const std::string& folder : folders) {
    for (const auto& entry : std::filesystem::directory_iterator(folder)) {
      const auto report = ReadJson(entry.path().string() + "/report/report.json");
      const auto truth = ReadJson(entry.path().string() + "/rig/truth.json");
      if (report.ok() && truth.ok()) rigs.push_back(ReadTraced(*report, *truth));
    }
  }
  return ThresholdRates(rigs);
}

int Main(int argc, char** argv) {
  CommandLine line;
  std::vector<std::string> rates_of;
  bool library = false, outside = false, mimics = false;
  cli::App app("Runs robostress-calibrate on generated rigs and prints how often it is right");
  app.add_option("--out", line.out, "Directory of rigs and reports; what is there is not repeated");
  app.add_option("--thresholds", rates_of,
                 "Instead: what other limits of the verdict would cost on the finished rigs in "
                 "these directories")
      ->check(cli::ExistingDirectory());
  app.add_option(
      "--effect", line.kinds,
      "Hidden effect, none, or two joined by + (on different joints of an arm: &), with @ and a "
      "hardship behind; repeat for more");
  app.add_flag("--library", library, "All effects of the library");
  app.add_flag("--mimics", mimics, "All pairs that the library's table takes for each other");
  app.add_flag("--outside", outside, "All effects that the library does not have");
  app.add_option("--family", line.family, "Of every rig: any, servo, torque, ..., arm");
  app.add_option("--none", line.none, "Rigs that hide nothing");
  app.add_option("--size", line.sizes, "small, medium, large; repeat for more");
  app.add_option("--first-seed", line.first_seed, "Below 10000: for tuning; from 10000: to report")
      ->capture_default_str();
  app.add_option("--seeds", line.seeds, "Of every kind and size")->capture_default_str();
  app.add_option("--workers", line.workers, "Processes at a time")->capture_default_str();
  app.add_option("--surrogates", line.surrogates, "Of calibrate")->capture_default_str();
  app.add_option("--calibrate", line.calibrate, "Program to judge; beside this one if not given");
  app.add_option("--motion", line.motion,
                 "In the place of all logs to fit one of what `robostress excite` designs, or of a "
                 "plain sweep with the same limits")
      ->check(cli::IsMember({"design", "sweep"}));
  app.add_option("--motion-seconds", line.motion_s, "Its length")->capture_default_str();
  app.add_option("--rounds", line.rounds,
                 "Motions at most, each of what `robostress excite --after` asks for where the "
                 "verdict leaves something open")
      ->capture_default_str();
  app.add_flag("--follow", line.follow,
               "Make the run that an ambiguous verdict asks for, and judge again with it");
  app.add_flag("--table-only", line.table_only, "Run nothing");
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  if (!rates_of.empty()) {
    std::fputs(RatesOf(rates_of).c_str(), stdout);
    return 0;
  }
  if (line.out.empty()) {
    std::fprintf(stderr, "calibration_study: no --out: give a directory for rigs and reports\n");
    return 1;
  }
  if (library)
    line.kinds.insert(line.kinds.end(), LibraryEffects().begin(), LibraryEffects().end());
  if (mimics) {
    const std::vector<std::string> pairs = MimicPairs();
    line.kinds.insert(line.kinds.end(), pairs.begin(), pairs.end());
  }
  if (outside)
    line.kinds.insert(line.kinds.end(), OutsideEffects().begin(), OutsideEffects().end());
  if (line.calibrate.empty()) {
    const auto found = FindProgram("calibrate");
    if (!found.ok()) {
      std::fprintf(stderr, "calibration_study: %s\n",
                   std::string(found.status().message()).c_str());
      return 1;
    }
    line.calibrate = *found;
  }
  line.excite = std::filesystem::path(line.calibrate).parent_path() / "robostress-excite";
  const std::vector<Case> cases = Cases(line);
  std::atomic<size_t> next{0};
  std::atomic<bool> failed{false};
  std::vector<std::thread> workers;
  for (int i = 0; i < line.workers && !line.table_only; ++i)
    workers.emplace_back([&] {
      for (size_t k = next++; k < cases.size() && !failed; k = next++) {
        const absl::Status status = RunCase(cases[k], line);
        if (status.ok()) continue;
        std::fprintf(stderr, "calibration_study: %s: %s\n", cases[k].folder.c_str(),
                     std::string(status.message()).c_str());
        failed = true;
      }
    });
  for (std::thread& worker : workers) worker.join();
  if (failed) return 1;
  const std::string table = Table(cases, line.rounds);
  std::fputs(table.c_str(), stdout);
  return WriteFileAtomically(line.out + "/table.md", table).ok() ? 0 : 1;
}

}  // namespace
}  // namespace robostress::generator

int main(int argc, char** argv) { return robostress::generator::Main(argc, argv); }
