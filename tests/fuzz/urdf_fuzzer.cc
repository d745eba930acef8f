// The readers of robot models that need no simulator: URDF, and MJCF without its shapes.
#include "calibration/model/mjcf_reduction.h"
#include "common/models/urdf_model.h"
#include "tests/fuzz/fuzz_check.h"
#include "tests/fuzz/splice_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  using namespace robostress::calibration;
  const std::string name = "/rigs/arm.urdf";
  const auto file = XmlFile::Parse(name, std::string(reinterpret_cast<const char*>(data), size));
  if (!file.ok()) {
    CheckRefusal(file.status(), name);
    return 0;
  }
  for (const MjcfShapes shapes : {MjcfShapes::kKept, MjcfShapes::kLeftOut}) {
    if (const auto reduced = ReduceMjcf(*file, shapes); reduced.ok()) {
      FuzzCheck(XmlFile::Parse(name, reduced->xml).ok(),
                "what was reduced is no XML: " + reduced->xml);
    } else {
      CheckRefusal(reduced.status(), name);
    }
  }
  const auto urdf = ReadUrdf(*file, {"elbow"});
  if (!urdf.ok()) {
    CheckRefusal(urdf.status(), name);
    return 0;
  }
  // What MuJoCo is given is a model that this reader takes as well.
  const auto again = XmlFile::Parse(name, urdf->xml);
  FuzzCheck(again.ok(), "what was written is no XML: " + urdf->xml);
  const auto read = ReadUrdf(*again, {"elbow"});
  FuzzCheck(read.ok(), "what was written is refused: " + std::string(read.status().message()));
  return 0;
}

extern "C" size_t LLVMFuzzerCustomMutator(uint8_t* data, size_t size, size_t max_size,
                                          unsigned int seed) {
  std::vector<size_t> tags;
  for (size_t i = 0; i < size; ++i) {
    if (data[i] == '<' || data[i] == ' ') tags.push_back(i);
  }
  return robostress::MutateBetween(tags, data, size, max_size, seed);
}
