#pragma once

#include <chrono>
#include <map>
#include <string>

namespace robostress {

// The progress line of a sweep: units and episodes done, and when the rest will be. Episodes are
// counted in the files the workers append to. A terminal gets one line that is rewritten every
// second, anything else a line every 20 s.
class Progress {
 public:
  enum class Output { kAutomatic, kNone };
  explicit Progress(Output output);

  // A unit that is to be run: where its episodes will appear and how many.
  void Expect(const std::string& id, const std::string& episodes_file, int episodes);
  void Start(const std::string& id);
  void Finish(const std::string& id, bool failed);
  void Show();
  // Prints a message without tearing the line.
  void Say(const std::string& message);
  // Prints the last state and leaves the line.
  void End();
  // "3/4 units (1 failed)  30/40 episodes (75 %)  elapsed 1:05  ETA 0:00"; what failed is not
  // waited for.
  std::string Line();

 private:
  struct Unit {
    std::string file;
    int expected = 0, recorded = 0;
    int before = 0;  // recorded by an earlier call
    bool running = false, finished = false, failed = false;
  };
  void Print(bool force);

  const bool enabled_, terminal_;
  const std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point last_print_;
  bool printed_ = false;
  std::map<std::string, Unit> units_;
};

// "0:42", "12:05", "3:02:10".
std::string FormatDuration(double seconds);
// Complete lines in a file; 0 when it is not there.
int CountLines(const std::string& file);

}  // namespace robostress
