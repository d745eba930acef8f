#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/models/model_table.h"
#include "common/models/xml_file.h"

namespace robostress::calibration {

struct MjcfReduction {
  std::string xml;  // needs no other file
  std::vector<ModelFact> facts;
};

// The rigid bodies, joints and sites of an MJCF file, for a model whose meshes are missing or that
// is written for a newer MuJoCo: shapes, actuators, sensors, contacts, tendons and constraints are
// left out, since no term of a joint's equation of motion needs them.
// FAILED_PRECONDITION, with line and remedy, where the rest would be another machine: a body that
// moves has shapes and no <inertial>, or parts stand in other files.
absl::StatusOr<MjcfReduction> ReduceMjcf(const XmlFile& file);

}  // namespace robostress::calibration
