#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/models/model_table.h"
#include "common/models/xml_file.h"

namespace robostress::calibration {

struct MjcfReduction {
  std::string xml;  // needs no other file but meshes
  std::vector<ModelFact> facts;
};

enum class MjcfShapes { kKept, kLeftOut };

// The rigid bodies, joints and sites of an MJCF file, and with `kKept` its shapes, meshes and
// couplings of joints, for a model whose meshes are missing or that is written for a newer MuJoCo:
// actuators, sensors, contacts, tendons, constraints and materials are left out, since no term of a
// joint's equation of motion needs them. Included files are read. Limits are `autolimits`, unless
// the file says not. FAILED_PRECONDITION, with file, line and remedy, where the rest would be
// another machine: without shapes a body that moves has some and no <inertial>; a <frame>, or what
// makes bodies by itself.
absl::StatusOr<MjcfReduction> ReduceMjcf(const XmlFile& file, MjcfShapes shapes);

}  // namespace robostress::calibration
