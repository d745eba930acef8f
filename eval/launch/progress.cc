#include "eval/launch/progress.h"

#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "eval/plan/titles.h"
#include "eval/store/run_directory.h"

namespace robostress {

Progress::Progress(Output output)
    : enabled_(output != Output::kNone),
      terminal_(isatty(STDERR_FILENO) != 0),
      start_(std::chrono::steady_clock::now()),
      last_print_(start_) {}

void Progress::Expect(const std::string& id, const std::string& episodes_file, int episodes) {
  const int before = std::min(CountLines(episodes_file), episodes);
  units_[id] = {episodes_file, episodes, before, before, false, false, false, {}};
  recorded_ += before;
  expected_ += episodes;
}

void Progress::Start(const std::string& id) {
  Unit& unit = units_[id];
  unit.running = true;
  unit.start = std::chrono::steady_clock::now();
  running_[id] = &unit;
}

void Progress::Count(Unit& unit) {
  const int recorded = std::min(CountLines(unit.file), unit.expected);
  // A worker that starts its unit again rewrites the file.
  const int before = std::min(unit.before, recorded);
  recorded_ += recorded - unit.recorded;
  fresh_ += (recorded - before) - (unit.recorded - unit.before);
  unit.recorded = recorded;
  unit.before = before;
}

void Progress::Finish(const std::string& id, bool failed) {
  Unit& unit = units_[id];
  Count(unit);
  running_.erase(id);
  unit.running = false;
  unit.finished = true;
  unit.failed = failed;
  if (failed) {
    failures_.push_back(id);
    lost_ += unit.expected - unit.recorded;
  } else {
    ++done_;
    // A part that was joined has left its file.
    recorded_ += unit.expected - unit.recorded;
    fresh_ += unit.expected - unit.recorded;
    unit.recorded = unit.expected;
  }
}

std::string Progress::Line() {
  for (auto& [id, unit] : running_) Count(*unit);
  const int remaining = expected_ - recorded_ - lost_;
  const double elapsed =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  std::string eta = "?";
  if (remaining == 0) {
    eta = FormatDuration(0);
  } else if (fresh_ > 0) {
    eta = FormatDuration(elapsed / fresh_ * remaining);
  }
  const std::string failures =
      failures_.empty() ? "" : absl::StrFormat(" (%d failed)", failures_.size());
  return absl::StrFormat("%d/%d units%s  %d/%d episodes (%d %%)  elapsed %s  ETA %s", done_,
                         units_.size(), failures, recorded_, expected_,
                         expected_ == 0 ? 100 : 100LL * recorded_ / expected_,
                         FormatDuration(elapsed), eta);
}

std::vector<std::string> Progress::Table(size_t units) {
  std::vector<std::string> lines = {Line()};
  const auto now = std::chrono::steady_clock::now();
  for (const auto& [id, unit] : running_) {
    if (lines.size() > units) {
      lines.push_back(absl::StrFormat("  ... and %d more", running_.size() - units));
      break;
    }
    const double elapsed = std::chrono::duration<double>(now - unit->start).count();
    const int fresh = unit->recorded - unit->before;
    const std::string eta =
        fresh == 0 ? "?" : FormatDuration(elapsed / fresh * (unit->expected - unit->recorded));
    lines.push_back(absl::StrFormat("  %-56s %4d/%-4d  %s  ETA %s", id, unit->recorded,
                                    unit->expected, FormatDuration(elapsed), eta));
  }
  for (size_t i = failures_.size() > 3 ? failures_.size() - 3 : 0; i < failures_.size(); ++i)
    lines.push_back(absl::StrCat("  FAILED ", failures_[i]));
  return lines;
}

namespace {

// Columns of the terminal; a line that wraps could not be taken back.
size_t Columns() {
  winsize size{};
  const bool known = ioctl(STDERR_FILENO, TIOCGWINSZ, &size) == 0 && size.ws_col > 1;
  return known ? size.ws_col - 1 : 79;
}

}  // namespace

void Progress::Clear() {
  if (!terminal_ || lines_ == 0) return;
  std::fprintf(stderr, "\r\033[K");
  for (; lines_ > 1; --lines_) std::fprintf(stderr, "\033[A\033[K");
  lines_ = 0;
}

void Progress::Print(bool force) {
  if (!enabled_) return;
  const auto now = std::chrono::steady_clock::now();
  const double since = std::chrono::duration<double>(now - last_print_).count();
  if (!force && printed_ && since < (terminal_ ? 0.5 : 20.0)) return;
  last_print_ = now;
  printed_ = true;
  if (terminal_) {
    Clear();
    std::vector<std::string> table = Table(8);
    for (std::string& line : table) line = line.substr(0, Columns());
    std::fprintf(stderr, "%s", absl::StrJoin(table, "\n").c_str());
    lines_ = table.size();
  } else {
    std::fprintf(stderr, "%s\n", Line().c_str());
  }
  std::fflush(stderr);
}

void Progress::Show() { Print(false); }

void Progress::Say(const std::string& message) {
  Clear();
  std::fprintf(stderr, "%s\n", message.c_str());
}

void Progress::End() {
  if (!printed_) return;
  Print(true);
  if (enabled_ && terminal_) std::fputc('\n', stderr);
  lines_ = 0;
}

}  // namespace robostress
