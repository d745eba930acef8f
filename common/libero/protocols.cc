#include "common/libero/protocols.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress {

const std::vector<LiberoProtocol>& LiberoProtocols() {
  static const std::vector<LiberoProtocol>& protocols = *new std::vector<LiberoProtocol>{
      {.name = "openpi",
       .step_limits = {{"libero_spatial", 220},
                       {"libero_object", 280},
                       {"libero_goal", 300},
                       {"libero_10", 520},
                       {"libero_90", 400}},
       .settle_steps = 10,
       .execute_steps = 5,
       .image_size = 224,
       .episodes = 50,
       .seed = 7,
       .fixtures = "numpy:7"},
      {.name = "lerobot",
       .step_limits = {{"libero_spatial", 280},
                       {"libero_object", 280},
                       {"libero_goal", 300},
                       {"libero_10", 520},
                       {"libero_90", 400}},
       .settle_steps = 10,
       .execute_steps = 10,
       .image_size = 256,
       .episodes = 10,
       .seed = 1000,
       .fixtures = "numpy-each:1000"},
  };
  return protocols;
}

int LiberoProtocol::StepLimit(const std::string& suite) const {
  for (const auto& [name, limit] : step_limits) {
    if (suite == name || absl::StartsWith(suite, name + "_")) return limit;
  }
  return 0;
}

std::string LiberoProtocolNames() {
  return absl::StrJoin(LiberoProtocols(), ", ",
                       [](std::string* text, const LiberoProtocol& p) { text->append(p.name); });
}

absl::StatusOr<LiberoProtocol> FindLiberoProtocol(const std::string& name) {
  for (const LiberoProtocol& protocol : LiberoProtocols()) {
    if (protocol.name == name) return protocol;
  }
  return absl::NotFoundError(
      absl::StrCat("protocol '", name, "' is unknown; known: ", LiberoProtocolNames()));
}

}  // namespace robostress
