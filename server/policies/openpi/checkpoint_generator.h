#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/safetensors_stream.h"
#include "server/policies/openpi/checkpoint.h"
#include "server/policies/openpi/openpi_config.h"

namespace robostress::openpi {

// A checkpoint of random weights, for tests of names, memory and time where no real one is at hand.
struct GeneratorOptions {
  bool pi05 = false;
  bool full = false;           // the published sizes; else tiny, with all sizes in the metadata
  DType dtype = DType::kBF16;  // of all weights, as openpi's converter stores them; or kF32
  CheckpointLayout layout = CheckpointLayout::kOpenpi;
  int64_t shards = 1;  // more than one: model-0000i-of-0000N.safetensors and an index
  uint64_t seed = 1;
  std::string out;  // a folder that does not exist yet
};

// Sizes of the published networks (horizon 50), and of small ones that no variant has.
OpenpiConfig FullConfig(bool pi05);
OpenpiConfig TinyGeneratedConfig(bool pi05);

// The weights of a file: names as the layout stores them, the tied embedding under the one name
// that its writer keeps, the expert's unused head.
std::vector<SafetensorsStream::Entry> CheckpointTensors(const GeneratorOptions& options);

// Writes weights, config.json and statistics the way the layout's writer does, tensor by tensor:
// memory stays at a few MiB. Values depend on seed and openpi's name only: uniform, variance 1/in
// for matrices. The folder appears when all of it is on the disk. The error names option, value and
// remedy.
absl::Status GenerateCheckpoint(const GeneratorOptions& options);

}  // namespace robostress::openpi
