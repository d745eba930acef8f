#pragma once

namespace robostress {

// `robot_client monitor`: looks at an arm without commanding it, for a person or, as JSON, for a
// program. argv[0] is "monitor". The program's exit code: 0 the arm is well; 1 something is wrong
// with it; 2 bad input or nothing to connect to.
int MonitorMain(int argc, char** argv);

}  // namespace robostress
