// Meshes of an arm: the first byte says of which kind the file is, and whether it is cut into
// parts, which takes a hundred times as long as reading it.
#include "common/models/mesh_file.h"
#include "common/models/mesh_parts.h"
#include "tests/fuzz/fuzz_check.h"
#include "tests/fuzz/splice_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  if (size == 0) return 0;
  const char* const endings[] = {".stl", ".obj", ".dae"};
  const std::string path = std::string("/arms/link") + endings[data[0] % 3];
  const auto corners =
      ParseMesh(path, std::string(reinterpret_cast<const char*>(data) + 1, size - 1));
  if (!corners.ok()) {
    CheckRefusal(corners.status(), path);
    return 0;
  }
  FuzzCheck(!corners->empty() && corners->size() % 3 == 0, "a part of a triangle");
  if (data[0] < 240) return 0;
  // What an arm may be as large as.
  for (const Eigen::Vector3d& corner : *corners)
    if (!(corner.cwiseAbs().maxCoeff() <= 5)) return 0;
  const std::vector<Hull> parts = PartsOf(*corners, 6);
  FuzzCheck(!parts.empty(), "no parts");
  for (const Eigen::Vector3d& corner : *corners) {
    double nearest = 1;
    for (const Hull& part : parts)
      nearest = std::min(nearest, Distance(part, {{corner}, 0}, Eigen::Isometry3d::Identity()));
    FuzzCheck(nearest <= 1e-6, "a corner is in no part");
  }
  return 0;
}

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t* data, size_t size, size_t max_size,
                                          unsigned int seed) {
  std::vector<size_t> words;
  for (size_t i = 0; i < size; ++i)
    if (data[i] == '<' || data[i] == ' ' || data[i] == '\n') words.push_back(i);
  return robostress::MutateBetween(words, data, size, max_size, seed);
}
