#pragma once

#include <mujoco/mujoco.h>

#include <cstdint>
#include <string>
#include <vector>

#include "common/safetensors.h"

namespace robostress::libero {

// One array of a compiled model under MuJoCo's name.
struct ModelArray {
  std::string name;
  DType dtype;                 // F64, I32 or U8
  std::vector<int64_t> shape;  // rows, and columns where a row has more than one
  const void* data;            // of the model
};

// The arrays that decide dynamics, names in the order of MuJoCo's header. Valid while `model`
// lives.
std::vector<ModelArray> ModelArrays(const mjModel& model);

}  // namespace robostress::libero
