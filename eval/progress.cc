#include "eval/progress.h"

#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <fstream>
#include <iterator>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress {

std::string FormatDuration(double seconds) {
  const int64_t total = static_cast<int64_t>(std::max(0.0, seconds) + 0.5);
  if (total < 3600) return absl::StrFormat("%d:%02d", total / 60, total % 60);
  return absl::StrFormat("%d:%02d:%02d", total / 3600, total / 60 % 60, total % 60);
}

int CountLines(const std::string& file) {
  std::ifstream stream(file, std::ios::binary);
  return static_cast<int>(
      std::count(std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>(), '\n'));
}

Progress::Progress(Output output)
    : enabled_(output != Output::kNone),
      terminal_(isatty(STDERR_FILENO) != 0),
      start_(std::chrono::steady_clock::now()),
      last_print_(start_) {}

void Progress::Expect(const std::string& id, const std::string& episodes_file, int episodes) {
  const int before = std::min(CountLines(episodes_file), episodes);
  units_[id] = {episodes_file, episodes, before, before, false, false};
}

void Progress::Start(const std::string& id) { units_[id].running = true; }

void Progress::Finish(const std::string& id, bool failed) {
  Unit& unit = units_[id];
  unit.recorded = std::min(CountLines(unit.file), unit.expected);
  unit.running = false;
  unit.finished = true;
  unit.failed = failed;
}

std::string Progress::Line() {
  int units_done = 0, units_failed = 0, episodes = 0, expected = 0, fresh = 0, remaining = 0;
  for (auto& [id, unit] : units_) {
    if (unit.running) {
      unit.recorded = std::min(CountLines(unit.file), unit.expected);
      // A worker that starts its unit again rewrites the file.
      unit.before = std::min(unit.before, unit.recorded);
    }
    units_done += unit.finished && !unit.failed;
    units_failed += unit.failed;
    episodes += unit.recorded;
    fresh += unit.recorded - unit.before;
    expected += unit.expected;
    if (!unit.failed) remaining += unit.expected - unit.recorded;
  }
  const double elapsed =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  std::string eta = "?";
  if (remaining == 0) {
    eta = FormatDuration(0);
  } else if (fresh > 0) {
    eta = FormatDuration(elapsed / fresh * remaining);
  }
  const std::string failures =
      units_failed == 0 ? "" : absl::StrFormat(" (%d failed)", units_failed);
  return absl::StrFormat("%d/%d units%s  %d/%d episodes (%d %%)  elapsed %s  ETA %s", units_done,
                         units_.size(), failures, episodes, expected,
                         expected == 0 ? 100 : 100 * episodes / expected, FormatDuration(elapsed),
                         eta);
}

void Progress::Print(bool force) {
  if (!enabled_) return;
  const auto now = std::chrono::steady_clock::now();
  const double since = std::chrono::duration<double>(now - last_print_).count();
  if (!force && printed_ && since < (terminal_ ? 0.5 : 20.0)) return;
  last_print_ = now;
  printed_ = true;
  std::fprintf(stderr, terminal_ ? "\r\033[K%s" : "%s\n", Line().c_str());
  std::fflush(stderr);
}

void Progress::Show() { Print(false); }

void Progress::Say(const std::string& message) {
  std::fprintf(stderr, "%s%s\n", enabled_ && terminal_ && printed_ ? "\r\033[K" : "",
               message.c_str());
}

void Progress::End() {
  if (!printed_) return;
  Print(true);
  if (enabled_ && terminal_) std::fputc('\n', stderr);
}

}  // namespace robostress
