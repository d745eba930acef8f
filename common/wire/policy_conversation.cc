#include "common/wire/policy_conversation.h"

#include <string_view>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/vla_eval_conversation.h"

namespace robostress {
namespace {

class OpenpiConversation : public PolicyConversation {
 public:
  OpenpiConversation(std::unique_ptr<OpenpiConnection> connection, const OpenpiDialect& dialect)
      : connection_(std::move(connection)), dialect_(dialect) {}

  const OpenpiValue& metadata() const override { return connection_->metadata(); }
  const std::string& address() const override { return connection_->address(); }
  absl::StatusOr<std::string> Write(const Observation& observation,
                                    const Extras& extras) const override {
    return WriteOpenpiObservation(observation, dialect_, extras);
  }
  absl::StatusOr<OpenpiValue> Ask(std::string question, absl::Duration limit) override {
    RS_ASSIGN_OR_RETURN(answer_, connection_->Ask(std::move(question), limit));
    absl::StatusOr<OpenpiValue> value = DecodeOpenpiValue(std::string_view(answer_));
    if (value.ok()) return value;
    return absl::InvalidArgumentError(absl::StrCat(
        address(), " answers with what is no msgpack of openpi's: ", value.status().message(),
        "; is it a policy server's port?"));
  }

 private:
  const std::unique_ptr<OpenpiConnection> connection_;
  const OpenpiDialect dialect_;
  std::string answer_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PolicyConversation>> PolicyConversation::Open(
    const std::string& url, const OpenpiDialect& dialect, const OpenpiConnectionOptions& options) {
  if (dialect.wire == kVlaEvalWire) return OpenVlaEvalConversation(url, dialect, options);
  RS_ASSIGN_OR_RETURN(std::unique_ptr<OpenpiConnection> connection,
                      OpenpiConnection::Connect(url, options));
  return std::make_unique<OpenpiConversation>(std::move(connection), dialect);
}

}  // namespace robostress
