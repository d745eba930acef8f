#pragma once

#include <string>

#include "server/policies/openpi/checkpoint.h"

namespace robostress::openpi {

struct OpenpiName {
  std::string name;         // openpi's
  CheckpointLayout layout;  // that the stored name shows
};

// Maps every generation of names to openpi's: "model." is stripped, and the old LeRobot's
// language_model.model.*, vision_tower.* and multi_modal_projector.* move below paligemma.model.
// Names that are none of the network's come back as they are.
OpenpiName ToOpenpiName(const std::string& stored);

// Whether openpi's `name` begins like one of the network's.
bool IsNetworkName(const std::string& name);

// The inverse: how a file of `layout` stores openpi's `name`.
std::string ToStoredName(const std::string& name, CheckpointLayout layout);

// LeRobot's files may hold pi0.5's time_mlp_{in,out} as action_time_mlp_{in,out} and the other way
// round; the name that the network uses, unchanged for all other names.
std::string TimeMlpName(const std::string& name, bool pi05);

// Tensors that no action depends on and that files hold all the same: the expert's head, statistics
// of old LeRobot files, buffers that a network computes itself; with `skip_state`, pi0's state
// projection, which LeRobot's pi0.5 may carry along.
bool IsUnusedTensor(const std::string& name, bool skip_state);

}  // namespace robostress::openpi
