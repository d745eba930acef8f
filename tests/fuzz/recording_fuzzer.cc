// The reader of recorded episodes, behind that of safetensors files.
#include "common/records/episode_recording.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string name = "episode.safetensors";
  const auto recording = ParseEpisodeRecording(name, {reinterpret_cast<const char*>(data), size});
  if (!recording.ok()) {
    CheckRefusal(recording.status(), name);
    return 0;
  }
  FuzzCheck(!recording->steps.empty(), "an episode without steps");
  FuzzCheck(recording->pictures.size() == recording->cameras.size(), "a camera without pictures");
  for (const auto& pictures : recording->pictures)
    FuzzCheck(pictures.size() == recording->steps.size(), "a step without a picture");
  for (const EpisodeRecording::Step& step : recording->steps) {
    FuzzCheck(step.commanded.allFinite() && step.sent.allFinite() && step.measured.allFinite() &&
                  step.proprioception.allFinite() && step.before.q.allFinite() &&
                  step.before.dq.allFinite() && step.before.tool.p_base_tool.allFinite(),
              "a number that is none");
  }
  return 0;
}
