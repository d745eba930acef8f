#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "proto/robostress/v1/policy.pb.h"
#include "server/policies/policy.h"
#include "server/sessions/registry_host.h"
#include "server/sessions/session_registry.h"
#include "server/wire/fair_executor.h"
#include "server/wire/grpc/grpc_call.h"

namespace robostress {

// By the name that sessions ask for.
using ServedPolicies = std::map<std::string, std::shared_ptr<const FlowPolicy>>;

// robostress.v1.PolicyService: converts, calls, says what came out. gRPC itself is grpc_call.h.
class PolicyHandlers {
 public:
  struct Options {
    int threads = 0, max_sessions = 0;  // for GetServerInfo
    absl::Duration expire_after;
    MethodCaps caps;
    int max_message_mib = 0;
  };
  // All outlive it. Feedback has threads of its own: a lockstep prediction waits for it.
  PolicyHandlers(const Options& options, const ServedPolicies* policies, SessionRegistry* sessions,
                 RegistryHost* host, FairExecutor* calls, FairExecutor* feedback_calls);

  std::vector<GrpcMethod> Methods();

 private:
  template <class Request, class Response>
  using Handler = absl::Status (PolicyHandlers::*)(GrpcCallView&, const Request&, Response&);

  // What the policies served here need [bytes].
  size_t LargestRequest(const std::string& method) const;
  template <class Request, class Response>
  GrpcMethod Unary(const char* name, Handler<Request, Response> handler);
  GrpcMethod PredictStream();
  uint64_t ExpiresAfter() const;  // [s]; 0: never
  absl::StatusOr<SessionHost::Opened> Open(const Caller& caller,
                                           const v1::OpenSessionRequest& request);

  absl::Status GetServerInfo(GrpcCallView& call, const v1::GetServerInfoRequest& request,
                             v1::GetServerInfoResponse& response);
  absl::Status OpenSession(GrpcCallView& call, const v1::OpenSessionRequest& request,
                           v1::OpenSessionResponse& response);
  absl::Status ResumeSession(GrpcCallView& call, const v1::ResumeSessionRequest& request,
                             v1::ResumeSessionResponse& response);
  absl::Status CloseSession(GrpcCallView& call, const v1::CloseSessionRequest& request,
                            v1::CloseSessionResponse& response);
  absl::Status StartEpisode(GrpcCallView& call, const v1::StartEpisodeRequest& request,
                            v1::StartEpisodeResponse& response);
  absl::Status Predict(GrpcCallView& call, const v1::PredictRequest& request,
                       v1::PredictResponse& response);
  absl::Status Feedback(GrpcCallView& call, const v1::FeedbackRequest& request,
                        v1::FeedbackAck& response);
  absl::Status GetStats(GrpcCallView& call, const v1::GetStatsRequest& request,
                        v1::GetStatsResponse& response);
  absl::Status ExportAdapter(GrpcCallView& call, const v1::ExportAdapterRequest& request,
                             v1::ExportAdapterResponse& response);
  absl::Status ImportAdapter(GrpcCallView& call, const v1::ImportAdapterRequest& request,
                             v1::ImportAdapterResponse& response);
  absl::Status RollbackAdapter(GrpcCallView& call, const v1::RollbackAdapterRequest& request,
                               v1::RollbackAdapterResponse& response);

  const Options options_;
  const std::string instance_;  // of this start of the server
  const ServedPolicies* const policies_;
  SessionRegistry* const sessions_;
  RegistryHost* const host_;
  FairExecutor* const calls_;
  FairExecutor* const feedback_calls_;
};

}  // namespace robostress
