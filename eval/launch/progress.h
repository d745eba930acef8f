#pragma once

#include <chrono>
#include <map>
#include <string>
#include <vector>

namespace robostress {

// The progress of a sweep: units and episodes done, and when the rest will be. Episodes are counted
// in the files the workers append to. A terminal gets a table that is rewritten every second: the
// sum, the units that run with their own estimates, the last failures. Anything else gets the sum,
// a line every 20 s.
class Progress {
 public:
  enum class Output { kAutomatic, kNone };
  explicit Progress(Output output);

  // A unit that is to be run: where its episodes will appear and how many.
  void Expect(const std::string& id, const std::string& episodes_file, int episodes);
  void Start(const std::string& id);
  void Finish(const std::string& id, bool failed);
  void Show();
  // Prints a message without tearing the table.
  void Say(const std::string& message);
  // Prints the last state and leaves it.
  void End();
  // "3/4 units (1 failed)  30/40 episodes (75 %)  elapsed 1:05  ETA 0:00"; what failed is not
  // waited for.
  std::string Line();
  // Line(), then a line for each unit that runs (at most `units`) and for the last failures.
  std::vector<std::string> Table(size_t units);

 private:
  struct Unit {
    std::string file;
    int expected = 0, recorded = 0;
    int before = 0;  // recorded by an earlier call
    bool running = false, finished = false, failed = false;
    std::chrono::steady_clock::time_point start;
  };
  void Count(Unit& unit);
  void Print(bool force);
  void Clear();  // takes the table off the terminal

  const bool enabled_, terminal_;
  const std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point last_print_;
  bool printed_ = false;
  size_t lines_ = 0;  // of the table on the terminal
  std::map<std::string, Unit> units_;
  std::map<std::string, Unit*> running_;
  std::vector<std::string> failures_;  // ids, in order
  // Sums over units_, kept up to date: there may be a hundred thousand.
  int done_ = 0, recorded_ = 0, expected_ = 0, fresh_ = 0, lost_ = 0;
};

}  // namespace robostress
