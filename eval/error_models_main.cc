// robostress-error-models: one picture per joint error model.

#include <cstdio>
#include <string>

#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/report/error_model_plots.h"

int main(int argc, char** argv) {
  robostress::cli::App app(
      "Draws friction, gravity residual, backlash and compliance of one joint over time: input, "
      "hidden state and output at nominal and at full severity, one SVG each.",
      "robostress error-models");
  std::string out;
  app.add_option("--out", out, "Folder of the pictures")->required();
  app.footer("\nExample\n  robostress error-models --out common/joint_errors/docs\n");
  return robostress::RunMain(app, argc, argv, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(robostress::MakeDirectories(out));
    for (const robostress::ErrorModelPicture& picture : robostress::DrawErrorModels()) {
      const std::string path = out + "/" + picture.name + ".svg";
      RS_RETURN_IF_ERROR(robostress::WriteFileAtomically(path, picture.svg));
      std::printf("%s\n", path.c_str());
    }
    return absl::OkStatus();
  });
}
