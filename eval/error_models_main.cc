// robostress-error-models: one picture per joint error model.

#include <cstdio>
#include <string>

#include "CLI/CLI.hpp"
#include "common/atomic_file.h"
#include "eval/report/error_model_plots.h"

int main(int argc, char** argv) {
  CLI::App app(
      "Draws friction, gravity residual, backlash and compliance of one joint over time: input, "
      "hidden state and output at nominal and at full severity, one SVG each.",
      "robostress error-models");
  std::string out;
  app.add_option("--out", out, "Folder of the pictures")->required();
  app.footer("\nExample\n  robostress error-models --out common/joint_errors/docs\n");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  absl::Status status = robostress::MakeDirectories(out);
  for (const robostress::ErrorModelPicture& picture : robostress::DrawErrorModels()) {
    const std::string path = out + "/" + picture.name + ".svg";
    if (status.ok()) status = robostress::WriteFileAtomically(path, picture.svg);
    if (status.ok()) std::printf("%s\n", path.c_str());
  }
  if (!status.ok()) {
    std::fprintf(stderr, "robostress error-models: %s\n", std::string(status.message()).c_str());
    return 1;
  }
  return 0;
}
