// The reader of openpi's messages, and what becomes of an observation, a session, a report, and a
// server's answer.
#include <cmath>

#include "common/wire/openpi_answer.h"
#include "common/wire/openpi_observation.h"
#include "server/wire/openpi/openpi_extensions.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string_view bytes(reinterpret_cast<const char*>(data), size);
  if (const absl::StatusOr<OpenpiValue> value = DecodeOpenpiValue(bytes); value.ok()) {
    const auto answer = ReadOpenpiAnswer(*value, {1, 50}, {1, 32});
    FuzzCheck(!answer.ok() || (answer->actions.allFinite() && answer->actions.rows() <= 50 &&
                               answer->actions.cols() <= 32),
              "impossible actions");
  }
  const absl::StatusOr<OpenpiValue> message = DecodeOpenpi(bytes);
  if (!message.ok()) {
    FuzzCheck(message.status().code() == absl::StatusCode::kInvalidArgument &&
                  !message.status().message().empty(),
              "a refusal without a reason");
    return 0;
  }
  PolicySpec policy;
  policy.name = "fuzzed";
  policy.cameras = {"a", "b"};
  policy.state_dim = 3;
  policy.action_dim = 7;
  if (const auto observation = ReadOpenpiObservation(*message, policy, {}, size % 2 == 0);
      observation.ok()) {
    FuzzCheck(observation->views.size() == 2, "a view is missing");
    for (const CameraView& view : observation->views)
      FuzzCheck(view.image.data.size() ==
                    size_t{3} * static_cast<size_t>(view.image.width * view.image.height),
                "an image of another size");
    FuzzCheck(observation->proprioception.size() == 3 && observation->proprioception.allFinite(),
              "an impossible state");
  }
  if (const OpenpiValue* session = message->Find("session"))
    ReadOpenpiSession(*session, {}).status().IgnoreError();
  if (const OpenpiValue* value = message->Find("executed")) {
    const auto executed = ReadOpenpiExecuted(*value, policy, 0.05);
    if (!executed.ok()) return 0;
    FuzzCheck(executed->states.size() >= 2 && executed->first_step >= 0, "a report of nothing");
    for (const RobotState& state : executed->states) {
      FuzzCheck(state.q.allFinite() && std::abs(state.tool.q_base_tool.norm() - 1) < 1e-2,
                "an impossible robot");
    }
  }
  return 0;
}
