#pragma once

#include <string>
#include <vector>

namespace robostress {

// OpenpiDialect::wire.
inline constexpr const char kOpenpiWire[] = "openpi", kVlaEvalWire[] = "vla_eval";

// By which keys an observation travels: data, read in both directions. A struct with Visit is its
// own YAML schema (common/config.h), so that another server's keys are a file.
struct OpenpiDialect {
  std::string name;
  std::vector<std::string> cameras;  // in the policy's order; empty: the cameras' own names
  std::string images_in;           // the map within the message that holds them; empty: the message
  bool planes_first = false;       // views go out as [3, H, W], else [H, W, 3]; both are read
  std::vector<std::string> state;  // its parts, in a row; empty: it is not sent
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
  // Who speaks first, and what stands around the keys: kOpenpiWire, kVlaEvalWire.
  std::string wire = kOpenpiWire;

  // Whether equal keys of an episode give equal sampling noise.
  bool PairsNoise() const { return !seed.empty() || !noise.empty() || describes_session; }
  // The cameras' keys, each with the map that it is in: "images/cam_high".
  std::vector<std::string> CameraPaths() const {
    std::vector<std::string> paths = cameras;
    if (!images_in.empty())
      for (std::string& path : paths) path.insert(0, images_in + "/");
    return paths;
  }

  template <class V>
  void Visit(V& v) {
    v.Field("name", name, "of this set of keys");
    v.Field("cameras", cameras,
            "keys of the views, in the policy's order; none: the cameras' own names");
    v.Field("images_in", images_in, "map that holds the views; empty: the message itself");
    v.Field("planes_first", planes_first, "views as [3, H, W] instead of [H, W, 3]");
    v.Field("state", state, "keys of the state's parts, in a row; none: it is not sent");
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
    v.Late("wire", wire, std::string(kOpenpiWire), "openpi, or vla_eval: hello, PNG, one action");
  }
};

// What is asked of a policy that somebody else serves. It says nothing of itself that can be relied
// on, so that what a policy of ours declares stands here.
struct RemotePolicyOptions {
  OpenpiDialect dialect;  // without a name: there is no remote policy
  // The simulator's, in the dialect's order; none: the policy is shown no picture.
  std::vector<std::string> cameras = {"agentview", "robot0_eye_in_hand"};
  int image_size = 224;  // [px] of the views, which are square
  int state_dim = 8, action_dim = 7;
  int execute_steps = 5;
  // Of the noise, where the dialect has a key for it: [noise_rows, noise_cols].
  int noise_rows = 0, noise_cols = 0;

  bool used() const { return !dialect.name.empty(); }

  template <class V>
  void Visit(V& v) {
    v.Section("dialect", dialect, "keys of the server's messages");
    v.Field("cameras", cameras, "the simulator's, in the dialect's order");
    v.Field("image_size", image_size, "of the views [px]");
    v.Field("state_dim", state_dim, "numbers of the state");
    v.Field("action_dim", action_dim, "numbers of an action");
    v.Field("execute_steps", execute_steps, "actions of a chunk that are executed");
    v.Field("noise_rows", noise_rows, "of the noise, where the dialect has a key for it");
    v.Field("noise_cols", noise_cols, "of the noise, where the dialect has a key for it");
  }
};

}  // namespace robostress
