#pragma once

namespace robostress {

// `robot_client cameras`: lists the cameras of this machine, or shows some of them in a browser.
// argv[0] is "cameras". The program's exit code: 0, 2 for bad input or no camera.
int CamerasMain(int argc, char** argv);

}  // namespace robostress
