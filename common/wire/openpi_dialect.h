#pragma once

#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "common/remote_options.h"
#include "common/types.h"

namespace robostress {

// Those of openpi's clients: "libero", "aloha", "droid"; the order in which a message's keys are
// looked for.
const std::vector<OpenpiDialect>& OpenpiDialects();
// Of servers that speak openpi's wire with words of their own: "vllm_omni", "sglang", "lerobot"
// (deploy/robostress_serve_lerobot.py), "robostress"; and "vla_eval", whose wire is another.
const std::vector<OpenpiDialect>& ServerDialects();
// One of those and these. NOT_FOUND names the known ones.
absl::StatusOr<OpenpiDialect> OpenpiDialectNamed(const std::string& name);
// Sets it, and what its servers usually want: vla-eval's are shown 256 px, and hand out one action
// an answer.
void UseDialect(OpenpiDialect dialect, RemotePolicyOptions& options);

// The message that asks for a prediction: views |u1 as they are, or PNG on vla-eval's wire; the
// state <f8, the prompt, and `extras`, keys with values that an OpenpiWriter wrote (`reset`,
// `seed`). INVALID_ARGUMENT where the dialect has no key for a camera, or the state is shorter than
// its parts.
absl::StatusOr<std::string> WriteOpenpiObservation(
    const Observation& observation, const OpenpiDialect& dialect,
    const std::vector<std::pair<std::string, std::string>>& extras = {});

}  // namespace robostress
