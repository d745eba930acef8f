#include "common/run_main.h"

#include <string_view>

#include "CLI/CLI.hpp"
#include "common/option_table.h"
#include "common/version.h"

namespace robostress {

std::optional<int> ParseCommandLine(cli::App& app, int argc, char** argv) {
  app.set_version_flag("--version", app.name() + " " + VersionText(), "Print the version and exit");
  if (argc == 2 && std::string_view(argv[1]) == kOptionTableFlag) {
    std::printf("%s\n", OptionTableText(app).c_str());
    return 0;
  }
  try {
    app.underlying().parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.underlying().exit(error) == 0 ? 0 : kWrongCommand;
  }
  return std::nullopt;
}

}  // namespace robostress
