#pragma once

#include <algorithm>
#include <array>
#include <variant>
#include <vector>

#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_value.h"
#include "tests/server/proxy/proxy_messages.h"
#include "tests/server/proxy/upstream.h"

namespace robostress {

// The policy of a test's upstream: leads LIBERO's tool towards (3, -2, 0) times 0.05 m, half of the
// way a step.
inline void LeadToGoal(Upstream::Socket& socket, const Upstream::Request&) {
  Upstream::Write(socket, std::string(1, '\x80'));  // openpi's metadata: an empty map
  while (const auto message = Upstream::Read(socket)) {
    const auto observation = DecodeOpenpi(std::string_view(message->bytes));
    const auto state = OpenpiNumbers("state", *observation->Find("observation/state"), 8);
    constexpr std::array kGoal = {3., -2., 0.};
    std::vector<double> action(7, 0);
    for (size_t j = 0; j < 3; ++j)
      action[j] = std::clamp(0.5 * (kGoal[j] - (*state)[j] / 0.05), -1., 1.);
    action[6] = -1;
    Upstream::Write(socket, ActionAnswer(action));
  }
}

}  // namespace robostress
