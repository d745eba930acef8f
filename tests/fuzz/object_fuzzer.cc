// The reader of LIBERO's object and fixture files, as a movable object and as a fixture.
#include "sim_worker/libero/object_file.h"
#include "tests/fuzz/fuzz_check.h"
#include "tests/fuzz/splice_mutator.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string path = "/assets/mug.xml";
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  for (const bool fixture : {false, true}) {
    absl::StatusOr<libero::ObjectFile> object =
        libero::ObjectFile::Parse(path, text, "mug_1", fixture);
    if (!object.ok()) {
      CheckRefusal(object.status(), path);
      continue;
    }
    for (const std::string& joint : object->joints())
      FuzzCheck(joint.starts_with("mug_1_"), "a joint of the object has another prefix: " + joint);
    // What composition does with it.
    tinyxml2::XMLDocument scene;
    scene.Parse("<mujoco><asset/><worldbody/></mujoco>");
    libero::MergeAssets(scene.RootElement()->FirstChildElement("asset"), object->asset());
    libero::AppendCopy(scene.RootElement()->FirstChildElement("worldbody"), object->body());
    tinyxml2::XMLPrinter printer;
    scene.Print(&printer);
    FuzzCheck(printer.CStrSize() > 1, "an empty scene");
  }
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
