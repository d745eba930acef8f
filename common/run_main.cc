#include "common/run_main.h"

#include <string_view>

#include "common/option_table.h"
#include "common/version.h"

namespace robostress {

std::optional<int> ParseCommandLine(CLI::App& app, int argc, char** argv) {
  app.set_version_flag("--version", app.get_name() + " " + VersionText(),
                       "Print the version and exit");
  if (argc == 2 && std::string_view(argv[1]) == kOptionTableFlag) {
    std::printf("%s\n", OptionTableText(app).c_str());
    return 0;
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : kWrongCommand;
  }
  return std::nullopt;
}

}  // namespace robostress
