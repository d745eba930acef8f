#include "common/wire/vla_eval_conversation.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "common/rollout/field_checks.h"
#include "common/status_macros.h"
#include "common/version.h"
#include "common/wire/openpi_answer.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_writer.h"
#include "common/wire/web_socket_client.h"

namespace robostress {
namespace {

constexpr int kProtocolVersion = 1;
constexpr size_t kMostActions = 1 << 16;  // numbers in a list
// Of LIBERO's state: position, axis-angle, two fingers.
constexpr int kLiberoState = 8, kAxisAngleAt = 3;

std::string_view TextIn(const OpenpiValue& map, const char* key) {
  const OpenpiValue* found = map.Find(key);
  const auto* text = found == nullptr ? nullptr : std::get_if<std::string_view>(&found->value);
  return text == nullptr ? std::string_view() : *text;
}

// The rotation of a robosuite state, as long as its angle in [0, 2 pi), turned the shorter way.
Eigen::VectorXf ShorterWay(Eigen::VectorXf state) {
  auto axis_angle = state.segment<3>(kAxisAngleAt);
  const double angle = axis_angle.cast<double>().norm();
  if (angle > M_PI) axis_angle *= static_cast<float>((angle - 2 * M_PI) / angle);
  return state;
}

class VlaEvalConversation : public PolicyConversation {
 public:
  VlaEvalConversation(std::unique_ptr<WebSocketClient> socket, const OpenpiDialect& dialect)
      : socket_(std::move(socket)), dialect_(dialect) {}

  absl::Status Greet(absl::Duration limit) {
    OpenpiWriter hello;
    hello.Map(2).Text("harness_version").Text(absl::StrCat("robostress ", BuildVersion()));
    hello.Text("protocol_version").Integer(kProtocolVersion);
    RS_RETURN_IF_ERROR(Tell("hello", hello.Take()));
    absl::StatusOr<Message> greeting = Hear(hello_bytes_, limit);
    if (!greeting.ok()) {
      if (!absl::IsInvalidArgument(greeting.status())) return greeting.status();
      return absl::FailedPreconditionError(
          absl::StrCat(greeting.status().message(),
                       "; a hello of vla-eval's was expected: if the server greets as openpi's "
                       "does, choose its keys by --dialect (libero, droid, aloha, a YAML file)"));
    }
    if (greeting->type != "hello")
      return Invalid(address(), " answers hello with '", greeting->type, "'");
    metadata_ = std::move(greeting->payload);
    const OpenpiValue* version = metadata_.Find("protocol_version");
    const auto* number = version == nullptr ? nullptr : std::get_if<int64_t>(&version->value);
    if (number != nullptr && *number != kProtocolVersion) {
      return absl::FailedPreconditionError(
          absl::StrCat(address(), " speaks version ", *number, " of vla-eval's protocol, we ",
                       kProtocolVersion, "; serve the model with another vla-eval"));
    }
    if (!Wishes("send_state")) {
      dialect_.state.clear();
      dialect_.state_sizes.clear();
    }
    return absl::OkStatus();
  }

  const OpenpiValue& metadata() const override { return metadata_; }
  const std::string& address() const override { return socket_->address(); }

  absl::Status Agree(PolicySpec& spec) const override {
    if (Wishes("absolute_action")) {
      return Invalid(address(),
                     " wishes absolute_action: its actions are poses, and the "
                     "simulator plays displacements of the hand; serve another model");
    }
    const size_t cameras = spec.cameras.size();
    if (!Wishes("send_wrist_image")) {
      spec.cameras.resize(std::min<size_t>(cameras, 1));
    } else if (cameras < 2) {
      return Invalid(address(),
                     " wishes for send_wrist_image, a second view; remote.cameras names ", cameras,
                     ": name the wrist's too");
    }
    return absl::OkStatus();
  }

  void BeginEpisode(const EpisodeNotice& episode) override {
    OpenpiWriter payload;
    payload.Map(1).Text("task").Map(4).Text("name").Text(episode.instruction);
    payload.Text("suite").Text(episode.suite).Text("task_id").Integer(episode.key.task);
    payload.Text("episode_idx").Integer(episode.key.episode);
    begins_ = payload.Take();
  }
  // What goes wrong is said to the next question.
  void EndEpisode() override {
    if (open_) Tell("episode_end", OpenpiWriter().Map(0).Take()).IgnoreError();
    open_ = false;
  }

  absl::StatusOr<std::string> Write(const Observation& observation,
                                    const Extras& extras) const override {
    if (Wishes("quat_no_antipodal") || dialect_.state.empty() ||
        observation.proprioception.size() != kLiberoState) {
      return WriteOpenpiObservation(observation, dialect_, extras);
    }
    Observation shown = observation;
    shown.proprioception = ShorterWay(std::move(shown.proprioception));
    return WriteOpenpiObservation(shown, dialect_, extras);
  }

  absl::StatusOr<OpenpiValue> Ask(std::string question, absl::Duration limit) override {
    if (!begins_.empty()) {
      EndEpisode();
      RS_RETURN_IF_ERROR(Tell("episode_start", std::exchange(begins_, "")));
      open_ = true;
    }
    RS_RETURN_IF_ERROR(Tell("observation", question));
    RS_ASSIGN_OR_RETURN(Message answer, Hear(answer_bytes_, limit));
    if (answer.type != "action")
      return Invalid(address(), " answers an observation with '", answer.type, "'");
    if (answer.seq != seq_) {
      return absl::FailedPreconditionError(
          absl::StrCat(address(), " answers message ", answer.seq, " where ", seq_,
                       " was asked; a model server with continuous_inference answers when it "
                       "likes, and a sweep asks and waits: serve it without"));
    }
    return Numbers(std::move(answer.payload));
  }

 private:
  struct Message {
    std::string type;
    int64_t seq = 0;
    OpenpiValue payload;
  };

  // The server's hello says so of what it wants to see.
  bool Wishes(const char* wish) const {
    const OpenpiValue* params = metadata_.Find("observation_params");
    const OpenpiValue* found = params == nullptr ? nullptr : params->Find(wish);
    const bool* flag = found == nullptr ? nullptr : std::get_if<bool>(&found->value);
    return flag != nullptr && *flag;
  }

  absl::Status Tell(const char* type, const std::string& payload) {
    OpenpiWriter message;
    message.Reserve(payload.size() + 128);
    message.Map(4).Text("type").Text(type).Text("payload").Value(payload);
    message.Text("seq").Integer(++seq_);
    message.Text("timestamp").Real(absl::ToDoubleSeconds(absl::Now() - absl::UnixEpoch()));
    return socket_->Send(message.Take());
  }

  // The next message, whose views are of `bytes`. INTERNAL with the server's words where it reports
  // an error; INVALID_ARGUMENT for what is no message of this wire.
  absl::StatusOr<Message> Hear(std::string& bytes, absl::Duration limit) {
    RS_ASSIGN_OR_RETURN(WebSocketMessage received, socket_->Receive(limit));
    bytes = std::move(received.bytes);
    if (received.text) {
      return Failed(bytes);
    }
    absl::StatusOr<OpenpiValue> value = DecodeOpenpi(std::string_view(bytes));
    if (!value.ok())
      return Invalid(address(),
                     " sends what is no message of vla-eval's: ", value.status().message());
    const OpenpiValue *payload = value->Find("payload"), *seq = value->Find("seq");
    const auto* number = seq == nullptr ? nullptr : std::get_if<int64_t>(&seq->value);
    Message message;
    message.type = TextIn(*value, "type");
    if (message.type.empty() || payload == nullptr || payload->map() == nullptr ||
        number == nullptr) {
      return Invalid(address(), " sends a message without vla-eval's type, payload and seq");
    }
    if (message.type == "error") {
      return Failed(std::string(TextIn(*payload, "error")));
    }
    message.seq = *number;
    message.payload = *payload;
    return message;
  }

  absl::Status Failed(const std::string& words) const {
    const absl::Status failed = OpenpiErrorText(words);
    return absl::Status(failed.code(), absl::StrCat(address(), ": ", failed.message()));
  }

  // The same with a list of numbers as an array, which some model servers hand out.
  absl::StatusOr<OpenpiValue> Numbers(OpenpiValue payload) {
    for (const char* key : {"actions", "action"}) {
      const OpenpiValue* found = payload.Find(key);
      if (found == nullptr || !std::holds_alternative<OpenpiValue::List>(found->value)) continue;
      const auto numbers = OpenpiNumbers(key, *found, kMostActions);
      if (!numbers.ok()) return Invalid(address(), ": ", numbers.status().message());
      row_ = *numbers;
      const std::string_view data(reinterpret_cast<const char*>(row_.data()),
                                  row_.size() * sizeof(double));
      return OpenpiValue{OpenpiArray{"<f8", {static_cast<int64_t>(row_.size())}, data}};
    }
    return payload;
  }

  const std::unique_ptr<WebSocketClient> socket_;
  OpenpiDialect dialect_;  // without a state where the server wishes for none
  std::string hello_bytes_, answer_bytes_;
  OpenpiValue metadata_;  // of hello_bytes_
  std::string begins_;    // payload of an episode's start that was not sent yet
  bool open_ = false;     // an episode is, at the server
  int64_t seq_ = 0;       // of the last message
  std::vector<double> row_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<PolicyConversation>> OpenVlaEvalConversation(
    const std::string& url, const OpenpiDialect& dialect, const OpenpiConnectionOptions& options) {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<WebSocketClient> socket,
                      WebSocketClient::Connect(url, options.socket));
  auto conversation = std::make_unique<VlaEvalConversation>(std::move(socket), dialect);
  RS_RETURN_IF_ERROR(conversation->Greet(options.metadata_timeout));
  return std::unique_ptr<PolicyConversation>(std::move(conversation));
}

}  // namespace robostress
