#include "common/wire/openpi_connection.h"

#include <algorithm>
#include <optional>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "common/wire/openpi_answer.h"
#include "spdlog/spdlog.h"

namespace robostress {

absl::StatusOr<std::unique_ptr<OpenpiConnection>> OpenpiConnection::Connect(
    const std::string& url, const OpenpiConnectionOptions& options) {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<WebSocketClient> socket,
                      WebSocketClient::Connect(url, options.socket));
  std::unique_ptr<OpenpiConnection> connection(new OpenpiConnection(std::move(socket)));
  const absl::Duration quiet = std::min(options.silence, options.metadata_timeout);
  if (!connection->socket_->Await(quiet) && quiet < options.metadata_timeout) {
    spdlog::warn("{} has said nothing for {}; if it is vla-eval's, choose --dialect vla_eval",
                 connection->address(), absl::FormatDuration(quiet));
  }
  absl::StatusOr<std::string> greeting = connection->Receive(options.metadata_timeout - quiet);
  if (absl::IsDeadlineExceeded(greeting.status())) {
    return absl::DeadlineExceededError(absl::StrCat(
        connection->address(), " opens a WebSocket and says nothing within ",
        absl::FormatDuration(options.metadata_timeout),
        ", where openpi's servers greet; if it is vla-eval's, choose --dialect vla_eval"));
  }
  RS_ASSIGN_OR_RETURN(connection->metadata_bytes_, std::move(greeting));
  absl::StatusOr<OpenpiValue> metadata =
      DecodeOpenpi(std::string_view(connection->metadata_bytes_));
  if (!metadata.ok()) {
    return absl::UnavailableError(absl::StrCat(
        connection->address(), " greets without openpi's metadata: ", metadata.status().message(),
        "; is it a policy server's port?"));
  }
  connection->metadata_ = *std::move(metadata);
  return connection;
}

absl::StatusOr<std::string> OpenpiConnection::Ask(std::string message, absl::Duration limit) {
  if (const std::optional<WebSocketMessage> early = socket_->TakeUnread()) {
    if (early->text)  // its last word before it closes
      return absl::UnavailableError(
          absl::StrCat(address(), ": ", OpenpiErrorText(early->bytes).message()));
    return absl::InternalError(
        absl::StrCat(address(), " sent a message of ", early->bytes.size(),
                     " bytes that nobody asked for, so that no answer can be trusted to belong to "
                     "its question; is it a server of openpi's wire, with one client?"));
  }
  RS_RETURN_IF_ERROR(socket_->Send(std::move(message)));
  return Receive(limit);
}

absl::StatusOr<std::string> OpenpiConnection::Receive(absl::Duration limit) {
  RS_ASSIGN_OR_RETURN(WebSocketMessage message, socket_->Receive(limit));
  if (!message.text) return std::move(message.bytes);
  const absl::Status failed = OpenpiErrorText(message.bytes);
  return absl::Status(failed.code(), absl::StrCat(address(), ": ", failed.message()));
}

}  // namespace robostress
