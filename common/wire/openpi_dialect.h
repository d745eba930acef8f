#pragma once

#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "common/types.h"

namespace robostress {

// By which keys an observation travels: data, read in both directions. A struct with Visit is its
// own YAML schema (common/config.h), so that another server's keys are a file.
struct OpenpiDialect {
  std::string name;
  std::vector<std::string> cameras;  // in the policy's order; empty: the cameras' own names
  std::string images_in;           // the map within the message that holds them; empty: the message
  bool planes_first = false;       // views go out as [3, H, W], else [H, W, 3]; both are read
  std::vector<std::string> state;  // its parts, in a row
  std::vector<int> state_sizes;    // numbers of each part but the last, which takes what remains
  std::string prompt = "prompt";
  std::string path;   // of the server, where its address has none
  std::string seed;   // key of an integer that decides the sampling noise; empty: it takes none
  std::string noise;  // key of that noise itself [horizon, model's action width], the same
  // How an episode begins: `reset` with a text makes a message of its own, {reset: reset_text};
  // without one it stands as true in the first observation. Empty: nothing is said.
  std::string reset, reset_text;
  std::string episode;  // key of {task, episode} in an episode's first observation; empty: none
  std::string session;  // key of a name that tells this client from others; empty: none
  bool describes_session = false;  // `session` holds suite and seed, for a server that draws the
                                   // noise as we do (docs/serve-a-policy.md)

  // Whether equal keys of an episode give equal sampling noise.
  bool PairsNoise() const { return !seed.empty() || !noise.empty() || describes_session; }
  // The cameras' keys, each with the map that it is in: "images/cam_high".
  std::vector<std::string> CameraPaths() const;

  template <class V>
  void Visit(V& v) {
    v.Field("name", name, "of this set of keys");
    v.Field("cameras", cameras,
            "keys of the views, in the policy's order; none: the cameras' own names");
    v.Field("images_in", images_in, "map that holds the views; empty: the message itself");
    v.Field("planes_first", planes_first, "views as [3, H, W] instead of [H, W, 3]");
    v.Field("state", state, "keys of the state's parts, in a row");
    v.Field("state_sizes", state_sizes, "numbers of each part but the last");
    v.Field("prompt", prompt, "key of the instruction");
    v.Field("path", path, "of the server, where its address has none");
    v.Field("seed", seed,
            "key of an integer that decides the sampling noise; empty: none is taken");
    v.Field("noise", noise, "key of the sampling noise itself; empty: none is taken");
    v.Field("reset", reset, "key by which an episode begins; empty: nothing is said");
    v.Field("reset_text", reset_text,
            "its text, in a message of its own; empty: true, in the first observation");
    v.Field("episode", episode, "key of {task, episode} at an episode's begin; empty: none");
    v.Field("session", session, "key of this client's name; empty: none");
    v.Field("describes_session", describes_session,
            "that key holds suite and seed: the server draws the noise by them, as ours does");
  }
};

// Those of openpi's clients: "libero", "aloha", "droid"; the order in which a message's keys are
// looked for.
const std::vector<OpenpiDialect>& OpenpiDialects();
// Of servers that speak openpi's wire with words of their own: "vllm_omni", "sglang", "lerobot"
// (deploy/robostress_serve_lerobot.py), "robostress".
const std::vector<OpenpiDialect>& ServerDialects();
// One of those and these. NOT_FOUND names the known ones.
absl::StatusOr<OpenpiDialect> OpenpiDialectNamed(const std::string& name);

// The message that asks for a prediction: views |u1 as they are, the state <f8, the prompt, and
// `extras`, keys with values that an OpenpiWriter wrote (`reset`, `seed`). INVALID_ARGUMENT where
// the dialect has no key for a camera, or the state is shorter than its parts.
absl::StatusOr<std::string> WriteOpenpiObservation(
    const Observation& observation, const OpenpiDialect& dialect,
    const std::vector<std::pair<std::string, std::string>>& extras = {});

}  // namespace robostress
