#pragma once

namespace robostress {

// `robot_client replay SOURCE`: plays what was recorded, and `robot_client excite`: moves the arm
// so that its joints can be calibrated. The console, limits, watchdogs and recording of every run.
int ReplayMain(int argc, char** argv);
int ExciteMain(int argc, char** argv);

}  // namespace robostress
