#include "robot_client/policy_connection.h"

#include <utility>

#include "adapter/method_options.h"
#include "common/config.h"
#include "common/robot_description.h"
#include "common/status_macros.h"

namespace robostress {
namespace {
// Acknowledgements are taken in passing: this many may be open before feedback would wait for one.
constexpr int kMaxUnacknowledged = 256;
}  // namespace

PolicyLink::Connect ConnectTo(const PolicyConnectionOptions& options, double control_period_s) {
  return [options, control_period_s]() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> {
    PolicyClientOptions client;
    client.address = options.server;
    client.connect_timeout_s = options.connect_timeout_s;
    client.call_timeout_s = options.call_timeout_s;
    client.max_unacknowledged = kMaxUnacknowledged;
    client.reconnect_timeout_s = 0;  // the arm holds and asks again; each call tries to resume
    RequestedSession session;
    session.robot = options.robot;
    session.control_space = kPiper.control_space;
    session.suite = options.suite;
    session.scenario = options.scenario;
    session.policy = options.policy;
    session.seed = options.seed;
    session.mode = options.mode;
    session.method_yaml = DumpConfig(*options.method);
    session.control_period_s = control_period_s;
    RS_ASSIGN_OR_RETURN(std::unique_ptr<GrpcPolicyClient> connected,
                        GrpcPolicyClient::Connect(client, session));
    return std::unique_ptr<PolicyEndpoint>(std::move(connected));
  };
}

}  // namespace robostress
