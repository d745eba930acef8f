#pragma once

#include <string>

namespace CLI {
class App;
}

namespace robostress {

// robostress policy adapter SUBCOMMAND: shows, exports, imports and merges adapter files (those
// that a session exports, docs/adapter-files.md).
class AdapterCommand {
 public:
  explicit AdapterCommand(cli::App& app);  // adds itself
  // Exit code: 0, or 2 with a message on stderr.
  int Run() const;

 private:
  cli::App *command_, *show_, *export_, *import_, *merge_;
  std::string adapter_, weights_, peft_, out_;
  std::string kind_ = "per_matrix", policy_ = "nano", method_ = "ours", model_hash_;
  bool json_ = false;
};

}  // namespace robostress
