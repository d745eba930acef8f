#pragma once

namespace robostress {

// `robot_client teach`: records demonstrations of a person. argv[0] is "teach". Returns the
// program's exit code, see ExitWith.
int TeachMain(int argc, char** argv);

}  // namespace robostress
