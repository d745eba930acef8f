// Messages of the gRPC wire as they become ours. The first byte chooses the message.
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "tests/fuzz/fuzz_check.h"

namespace robostress {
namespace {

template <class Message, class Check>
void Read(const std::string& bytes, Check&& check) {
  Message message;
  if (!message.ParseFromString(bytes)) return;
  const auto value = FromProto(message);
  if (value.ok()) {
    check(*value);
  } else {
    FuzzCheck(value.status().code() == absl::StatusCode::kInvalidArgument &&
                  !value.status().message().empty(),
              "a refusal that is no INVALID_ARGUMENT: " + value.status().ToString());
  }
}

}  // namespace
}  // namespace robostress

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  if (size == 0) return 0;
  const std::string bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  switch (data[0] % 5) {
    case 0:
      Read<v1::Observation>(bytes, [](const Observation& observation) {
        FuzzCheck(observation.proprioception.allFinite(), "a state that is not finite");
        for (const CameraView& view : observation.views)
          FuzzCheck(view.image.data.size() ==
                        size_t{3} * static_cast<size_t>(view.image.width * view.image.height),
                    "an image of another size");
      });
      break;
    case 1:
      Read<v1::ExecutedChunk>(bytes, [](const ExecutedChunk& chunk) {
        FuzzCheck(!chunk.steps.empty() && chunk.sequence > 0, "a chunk of nothing");
        for (const ExecutedStep& step : chunk.steps)
          FuzzCheck(step.policy_command.allFinite() && step.sent_command.allFinite() &&
                        step.before.q.allFinite(),
                    "a step that is not finite");
      });
      break;
    case 2:
      Read<v1::SessionSpec>(bytes, [](const RequestedSession& spec) {
        FuzzCheck(spec.severity >= 1 && spec.severity <= 5, "an impossible severity");
      });
      break;
    case 3:
      Read<v1::PredictResponse>(bytes, [](const PredictedChunk& prediction) {
        FuzzCheck(prediction.actions.allFinite(), "actions that are not finite");
      });
      break;
    default:
      Read<v1::PolicySpec>(bytes, [](const PolicySpec&) {});
  }
  return 0;
}
