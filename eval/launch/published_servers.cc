#include "eval/launch/published_servers.h"

#include <poll.h>

#include <chrono>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;
using SteadyClock = std::chrono::steady_clock;

absl::StatusOr<ServerPlace> ReadPlace(const std::string& file) {
  const absl::StatusOr<std::string> text = ReadFile(file);
  if (!text.ok()) return text.status();
  const json record = json::parse(*text, nullptr, false);
  if (!record.is_object() || !record.contains("address") || !record["address"].is_string() ||
      !record.contains("machine") || !record["machine"].is_string())
    return absl::DataLossError(absl::StrCat(file, " names no server"));
  return ServerPlace{record["address"], record["machine"]};
}

}  // namespace

absl::Status PublishServer(const Submission& submission, const std::string& policy, int index,
                           const ServerPlace& place) {
  const json record = {{"address", place.address}, {"machine", place.machine}};
  return WriteFileAtomically(submission.ServerFile(policy, index), record.dump() + "\n");
}

absl::StatusOr<ServerPlace> PublishedServers::Find(const std::string& policy) {
  if (!elsewhere_.empty()) return elsewhere_.Next();
  const auto deadline = SteadyClock::now() + std::chrono::duration<double>(patience_s_);
  while (true) {
    for (int k = 0; k < submission_.servers(); ++k) {
      const int index = (preferred_ + k) % submission_.servers();
      const absl::StatusOr<ServerPlace> place = ReadPlace(submission_.ServerFile(policy, index));
      if (place.ok() && Accepts(place->address)) return place;
    }
    if (SteadyClock::now() > deadline) {
      return absl::UnavailableError(
          absl::StrCat("no server of policy ", policy, " has answered for ", patience_s_,
                       " s; its job's log is in ", submission_.run().path(), "/logs"));
    }
    pollfd item{signals_.fd(), POLLIN, 0};
    if (poll(&item, 1, 500) > 0) return absl::CancelledError("interrupted");
  }
}

bool PublishedServers::Lost(const std::string&, const ServerPlace& place) {
  return elsewhere_.empty() ? !Accepts(place.address) : elsewhere_.Lost(place);
}

}  // namespace robostress
