#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "server/operations/span_trace.h"
#include "server/operations/telemetry.h"
#include "server/sessions/session_host.h"
#include "server/sessions/session_registry.h"

namespace robostress {

// What every wire does with a session, in one place: finds it, calls it, and shows it to metrics,
// traces, logs and the live page. Any thread.
class RegistryHost : public SessionHost {
 public:
  // Everything must outlive it. `guard`: of sessions that ask for none.
  RegistryHost(SessionRegistry* registry, std::vector<PolicySpec> policies,
               const GuardOptions& guard, Telemetry* telemetry, TraceLog* traces)
      : registry_(registry),
        policies_(std::move(policies)),
        guard_(guard),
        telemetry_(telemetry),
        traces_(traces) {}

  std::vector<PolicySpec> policies() const override { return policies_; }
  absl::StatusOr<Opened> Open(const Caller& caller, const SessionSpec& spec,
                              const SessionScheduling& scheduling = {},
                              const GuardOptions* guard = nullptr) override;
  absl::StatusOr<Opened> Resume(const Caller& caller, const std::string& id,
                                const std::string& token) override;
  absl::Status Close(const Caller& caller, const std::string& id) override;
  void Attach(const std::string& id) override { registry_->Attach(id); }
  void Detach(const std::string& id) override { registry_->Detach(id); }
  absl::StatusOr<std::unique_ptr<SessionUse>> Use(const Caller& caller,
                                                  const std::string& id) override;

  // Every session as it stands.
  std::vector<SessionFigures> Figures() const;

 private:
  SessionRegistry* const registry_;
  const std::vector<PolicySpec> policies_;
  const GuardOptions guard_;
  Telemetry* const telemetry_;
  TraceLog* const traces_;
};

}  // namespace robostress
