// libero_visual_bounds ASSETS FILE...: prints the rows of visual_bounds.cc for mesh files below
// ASSETS.

#include <mujoco/mujoco.h>

#include <cstdio>
#include <string>

#include "absl/strings/str_cat.h"
#include "sim_worker/panda_sim.h"

namespace {

// The sphere carries the mass that a body needs; the mesh is visual, as in the originals.
std::string SceneWith(const std::string& file) {
  return absl::StrCat(
      "<mujoco><compiler inertiagrouprange='0 0'/><asset><mesh name='visual' file='", file,
      "'/></asset><worldbody><body><geom type='mesh' mesh='visual' group='1'/>"
      "<geom type='sphere' size='1' group='0'/></body></worldbody></mujoco>");
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) {
    std::fprintf(stderr,
                 "usage: libero_visual_bounds ASSETS FILE...   (FILE relative to ASSETS)\n");
    return 2;
  }
  for (int i = 2; i < argc; ++i) {
    const std::string path = absl::StrCat(argv[1], "/", argv[i]);
    const auto model = robostress::CompileModel(path, SceneWith(path));
    if (!model.ok()) {
      std::fprintf(stderr, "libero_visual_bounds: %s\n",
                   std::string(model.status().message()).c_str());
      return 1;
    }
    const double* centre = (*model)->geom_pos;
    std::printf("    {\"%s\", {{%.9g, %.9g, %.9g}, %.9g}},\n", argv[i], centre[0], centre[1],
                centre[2], (*model)->geom_rbound[0]);
  }
  return 0;
}
