#include "common/wire/remote_policy.h"

#include <unistd.h>

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "common/atomic_file.h"
#include "common/rollout/field_checks.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/noise_key.h"
#include "common/status_macros.h"
#include "common/wire/openpi_answer.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/openpi_writer.h"
#include "common/wire/web_url.h"
#include "nlohmann/json.hpp"
#include "spdlog/spdlog.h"

namespace robostress {
namespace {

using nlohmann::json;

// Between two attempts: a server that restarts loads its weights.
constexpr absl::Duration kFirstPause = absl::Milliseconds(200), kLongestPause = absl::Seconds(5);
constexpr int kAttempts = 5;        // of one question, each on a connection of its own
constexpr size_t kLongText = 4096;  // [bytes] of metadata; longer ones are kept as their hash

json JsonOf(const OpenpiValue& value) {
  struct Visitor {
    json operator()(std::monostate) const { return nullptr; }
    json operator()(bool v) const { return v; }
    json operator()(int64_t v) const { return v; }
    json operator()(double v) const { return v; }
    json operator()(std::string_view v) const {
      if (v.size() <= kLongText) return std::string(v);
      return {{"bytes", v.size()}, {"sha256", Sha256Hex(v)}};
    }
    json operator()(const OpenpiArray& v) const {
      return {{"dtype", v.dtype}, {"shape", v.shape}, {"sha256", Sha256Hex(v.data)}};
    }
    json operator()(const OpenpiValue::List& v) const {
      json list = json::array();
      for (const OpenpiValue& item : v) list.push_back(JsonOf(item));
      return list;
    }
    json operator()(const OpenpiValue::Map& v) const {
      json map = json::object();
      for (const auto& [key, item] : v) map[key] = JsonOf(item);
      return map;
    }
  };
  return std::visit(Visitor{}, value.value);
}

std::string Dumped(const json& value) {
  return value.dump(-1, ' ', false, json::error_handler_t::replace);
}

// Its leaves by JSON pointer; empty for an empty map.
json FlatJson(const OpenpiValue& metadata) {
  const json whole = JsonOf(metadata);
  return whole.empty() ? json::object() : whole.flatten();
}

// Pointers whose leaf is not the same in both.
std::set<std::string> Differences(const json& a, const json& b) {
  std::set<std::string> pointers;
  for (const auto* side : {&a, &b})
    for (const auto& [pointer, leaf] : side->items())
      if (!a.contains(pointer) || !b.contains(pointer) || a[pointer] != b[pointer])
        pointers.insert(pointer);
  return pointers;
}

// Whether the server lists what it takes beyond openpi's keys, and `key` is not among that.
bool Denies(const OpenpiValue& metadata, std::string_view key) {
  const OpenpiValue* extensions = metadata.Find("extensions");
  const auto* list =
      extensions == nullptr ? nullptr : std::get_if<OpenpiValue::List>(&extensions->value);
  return list != nullptr && std::none_of(list->begin(), list->end(), [&](const OpenpiValue& item) {
           const auto* text = std::get_if<std::string_view>(&item.value);
           return text != nullptr && *text == key;
         });
}

bool ComesAndGoes(const absl::Status& status) {
  return absl::IsUnavailable(status) || absl::IsDeadlineExceeded(status);
}

std::string MapOf(const std::vector<std::pair<std::string, std::string>>& entries) {
  OpenpiWriter writer;
  writer.Map(static_cast<uint32_t>(entries.size()));
  for (const auto& [key, value] : entries) writer.Text(key).Value(value);
  return writer.Take();
}

std::string Integer(int64_t value) { return OpenpiWriter().Integer(value).Take(); }
std::string Text(const std::string& text) { return OpenpiWriter().Text(text).Take(); }

}  // namespace

absl::Status CheckRemotePolicy(const RemotePolicyOptions& options) {
  const OpenpiDialect& dialect = options.dialect;
  const auto cameras = options.cameras.size();
  RS_RETURN_IF_ERROR(CheckRange("remote.cameras", cameras, 0, WireLimits::kViews));
  if (dialect.wire != kOpenpiWire && dialect.wire != kVlaEvalWire) {
    return Invalid("remote.dialect.wire is '", dialect.wire, "', must be ", kOpenpiWire, " or ",
                   kVlaEvalWire);
  }
  if (!dialect.cameras.empty() && dialect.cameras.size() < cameras) {
    return Invalid("remote.cameras names ", cameras, " cameras, dialect ", dialect.name,
                   " has keys for ", dialect.cameras.size());
  }
  RS_RETURN_IF_ERROR(
      CheckRange("remote.image_size", options.image_size, 1, WireLimits::kImageSide));
  RS_RETURN_IF_ERROR(CheckRange("remote.state_dim", options.state_dim, 1, WireLimits::kStateDim));
  RS_RETURN_IF_ERROR(
      CheckRange("remote.action_dim", options.action_dim, 2, WireLimits::kActionDim));
  RS_RETURN_IF_ERROR(
      CheckRange("remote.execute_steps", options.execute_steps, 1, WireLimits::kHorizon));
  if (dialect.noise.empty()) return absl::OkStatus();
  RS_RETURN_IF_ERROR(CheckRange("remote.noise_rows", options.noise_rows, 1, WireLimits::kHorizon));
  return CheckRange("remote.noise_cols", options.noise_cols, 1, WireLimits::kActionDim);
}

RemotePolicy::RemotePolicy(std::string url, const RemotePolicyOptions& options,
                           const SessionSetting& setting, std::string noise_stream,
                           const RemotePolicyConnection& connection)
    : url_(std::move(url)),
      noise_stream_(std::move(noise_stream)),
      options_(options),
      setting_(setting),
      connection_options_(connection) {
  asked_.name = setting.policy;
  asked_.cameras = options.cameras;
  asked_.image_width = asked_.image_height = options.image_size;
  asked_.state_dim = options.state_dim;
  asked_.action_dim = options.action_dim;
  asked_.horizon = asked_.execute_steps = options.execute_steps;
  asked_.control_space = setting.control_space;
}

absl::StatusOr<std::unique_ptr<RemotePolicy>> RemotePolicy::Connect(
    const std::string& url, const RemotePolicyOptions& options, const SessionSetting& setting,
    const std::string& noise_stream, const RemotePolicyConnection& connection) {
  RS_RETURN_IF_ERROR(CheckRemotePolicy(options));
  RS_ASSIGN_OR_RETURN(WebUrl where, ParseWebUrl(url));
  if (where.target == "/" && !options.dialect.path.empty()) where.target = options.dialect.path;
  std::unique_ptr<RemotePolicy> policy(
      new RemotePolicy(where.text(), options, setting, noise_stream, connection));
  RS_RETURN_IF_ERROR(policy->Dial());
  if (const json first = FlatJson(policy->connection_->metadata()); !first.empty()) {
    policy->connection_.reset();  // a server may have room for one
    RS_RETURN_IF_ERROR(policy->Dial());
    policy->volatile_ = Differences(first, FlatJson(policy->connection_->metadata()));
  }
  policy->metadata_hash_ = Sha256Hex(policy->StableMetadata());
  if (!policy->pairs_noise()) {
    spdlog::info("{}: takes neither seed nor noise; sampling noise is not paired",
                 policy->address());
  }
  policy->spec_.model_hash = Sha256Hex(absl::StrCat(setting.policy, "\n", policy->metadata_hash_));
  // Two units, or two sweeps, at one server must not begin each other's episodes.
  policy->session_name_ = absl::StrCat(
      "robostress-",
      Sha256Hex(absl::StrCat(getpid(), "/", absl::GetCurrentTimeNanos())).substr(0, 16));
  return policy;
}

absl::Status RemotePolicy::Dial() {
  RS_ASSIGN_OR_RETURN(connection_,
                      PolicyConversation::Open(url_, options_.dialect, connection_options_.wire));
  connection_begins_ = true;
  answered_here_ = false;
  episode_begins_ = episode_open_;  // whatever the server knew of it
  if (!metadata_hash_.empty() && metadata_hash_ != Sha256Hex(StableMetadata()) &&
      !metadata_changed_) {
    metadata_changed_ = true;
    spdlog::warn("{}: its metadata changed while the unit runs; is it the same model?", address());
  }
  PolicySpec agreed = asked_;
  RS_RETURN_IF_ERROR(CheckMetadata(agreed));
  const auto shown = [](const PolicySpec& spec) {
    return absl::StrCat("[", absl::StrJoin(spec.cameras, ", "), "] of ", spec.image_width, " x ",
                        spec.image_height, " px, execute_steps ", spec.execute_steps);
  };
  if (metadata_hash_.empty()) {
    spec_ = agreed;
  } else if (shown(agreed) != shown(spec_)) {
    return absl::FailedPreconditionError(absl::StrCat(
        address(), " wishes for ", shown(agreed), ", and wished for ", shown(spec_),
        " when the unit began: it serves another model now; serve the first one, and run the same "
        "command again, or begin another --out"));
  }
  return absl::OkStatus();
}

std::string RemotePolicy::StableMetadata() const {
  json flat = FlatJson(connection_->metadata());
  for (const std::string& pointer : volatile_) flat.erase(pointer);
  return Dumped(flat);
}

bool RemotePolicy::pairs_noise() const {
  const OpenpiDialect& dialect = options_.dialect;
  return takes_seed_ || !dialect.noise.empty() || dialect.describes_session;
}

std::string RemotePolicy::metadata() const { return Dumped(JsonOf(connection_->metadata())); }

absl::Status RemotePolicy::CheckMetadata(PolicySpec& spec) {
  RS_RETURN_IF_ERROR(connection_->Agree(spec));
  const OpenpiValue& metadata = connection_->metadata();
  const auto check = [&](const char* what, const OpenpiValue* said, int64_t ours) -> absl::Status {
    const auto* number = said == nullptr ? nullptr : std::get_if<int64_t>(&said->value);
    if (number == nullptr || *number == ours) return absl::OkStatus();
    return Invalid(address(), " says ", what, " ", *number, ", remote.", what, " is ", ours,
                   "; set it to the server's, or ask the right server");
  };
  takes_seed_ = !options_.dialect.seed.empty() && !Denies(metadata, options_.dialect.seed);
  // SGLang's, and ours.
  if (const OpenpiValue* output = metadata.Find("output")) {
    RS_RETURN_IF_ERROR(check("action_dim", output->Find("action_dim"), options_.action_dim));
    const OpenpiValue* horizon = output->Find("action_horizon");
    const auto* rows = horizon == nullptr ? nullptr : std::get_if<int64_t>(&horizon->value);
    if (rows != nullptr && *rows < options_.execute_steps) {
      return Invalid(address(), " says action_horizon ", *rows, ", remote.execute_steps is ",
                     options_.execute_steps, "; execute no more than that");
    }
  }
  if (const OpenpiValue* input = metadata.Find("input"))
    RS_RETURN_IF_ERROR(check("state_dim", input->Find("state_dim"), options_.state_dim));
  const OpenpiValue* policies = metadata.Find("policies");
  const auto* list =
      policies == nullptr ? nullptr : std::get_if<OpenpiValue::List>(&policies->value);
  if (list == nullptr || list->empty()) return absl::OkStatus();
  const OpenpiValue* served = nullptr;
  std::string names;
  for (const OpenpiValue& policy : *list) {
    const OpenpiValue* name = policy.Find("name");
    const auto* text = name == nullptr ? nullptr : std::get_if<std::string_view>(&name->value);
    if (text == nullptr) continue;
    absl::StrAppend(&names, names.empty() ? "" : ", ", std::string(*text));
    if (*text == setting_.policy) served = &policy;
  }
  if (served == nullptr && options_.dialect.describes_session) {
    return absl::NotFoundError(
        absl::StrCat(address(), " serves ", names, "; '", setting_.policy, "' is not among them"));
  }
  if (served == nullptr) served = &list->front();
  if (options_.dialect.describes_session) Adopt(*served, spec);
  RS_RETURN_IF_ERROR(check("state_dim", served->Find("state_dim"), options_.state_dim));
  return check("action_dim", served->Find("action_dim"), options_.action_dim);
}

void RemotePolicy::Adopt(const OpenpiValue& declared, PolicySpec& spec) {
  const auto integer = [&](const char* key, int& value, int most) {
    const OpenpiValue* found = declared.Find(key);
    const auto* number = found == nullptr ? nullptr : std::get_if<int64_t>(&found->value);
    if (number != nullptr && *number >= 1 && *number <= most) value = static_cast<int>(*number);
  };
  integer("image_width", spec.image_width, WireLimits::kImageSide);
  integer("image_height", spec.image_height, WireLimits::kImageSide);
  integer("execute_steps", spec.execute_steps, WireLimits::kHorizon);
  spec.horizon = spec.execute_steps;
  const OpenpiValue* cameras = declared.Find("cameras");
  const auto* names =
      cameras == nullptr ? nullptr : std::get_if<OpenpiValue::List>(&cameras->value);
  if (names == nullptr || names->size() > WireLimits::kViews) return;
  spec.cameras.clear();
  for (const OpenpiValue& name : *names)
    if (const auto* text = std::get_if<std::string_view>(&name.value))
      spec.cameras.emplace_back(*text);
}

StreamKey RemotePolicy::NoiseKey(int chunk) const {
  return PredictionNoiseKey(setting_, noise_stream_, {episode_, chunk});
}

std::string RemotePolicy::SessionText() const {
  if (!options_.dialect.describes_session) return Text(session_name_);
  std::vector<std::pair<std::string, std::string>> session = {
      {"policy", Text(setting_.policy)},     {"suite", Text(setting_.suite)},
      {"scenario", Text(setting_.scenario)}, {"severity", Integer(setting_.severity)},
      {"seed", Integer(setting_.seed)},      {"method", Text("base")}};
  if (noise_stream_ != "policy") {
    OpenpiWriter options;
    options.List(1).Text(absl::StrCat("noise_stream=", noise_stream_));
    session.emplace_back("method_options", options.Take());
  }
  return MapOf(session);
}

std::vector<std::pair<std::string, std::string>> RemotePolicy::Extras(int chunk) const {
  const OpenpiDialect& dialect = options_.dialect;
  std::vector<std::pair<std::string, std::string>> extras;
  if (!dialect.session.empty() && (connection_begins_ || !dialect.describes_session))
    extras.emplace_back(dialect.session, SessionText());
  if (episode_begins_ && !dialect.reset.empty() && dialect.reset_text.empty())
    extras.emplace_back(dialect.reset, OpenpiWriter().Boolean(true).Take());
  if (episode_begins_ && !dialect.episode.empty()) {
    extras.emplace_back(dialect.episode, MapOf({{"task", Integer(episode_.task)},
                                                {"episode", Integer(episode_.episode)}}));
  }
  if (takes_seed_) {
    RandomStream stream(NoiseKey(chunk));
    extras.emplace_back(dialect.seed, Integer(stream.NextUint32() >> 1));
  }
  if (!dialect.noise.empty()) {
    RandomStream stream(NoiseKey(chunk));
    Eigen::MatrixXf noise(options_.noise_rows, options_.noise_cols);
    for (Eigen::Index i = 0; i < noise.rows(); ++i)
      for (Eigen::Index j = 0; j < noise.cols(); ++j)
        noise(i, j) = static_cast<float>(stream.Normal());
    extras.emplace_back(dialect.noise, OpenpiWriter().Array(noise).Take());
  }
  return extras;
}

absl::Status RemotePolicy::DialAgain(Monotonic::time_point gone, const absl::Status& lost) {
  for (absl::Duration pause = kFirstPause;; pause = std::min(2 * pause, kLongestPause)) {
    const absl::Status dialled = Dial();
    if (dialled.ok()) {
      ++reconnections_;
      spdlog::info("{}: connected again ({} so far)", address(), reconnections_);
    }
    if (!ComesAndGoes(dialled)) return dialled;
    if (Monotonic::now() + absl::ToChronoNanoseconds(pause) > gone) {
      return absl::UnavailableError(absl::StrCat(lost.message(), "; then it was gone for ",
                                                 absl::FormatDuration(connection_options_.absence),
                                                 ": ", dialled.message()));
    }
    absl::SleepFor(pause);
  }
}

absl::StatusOr<OpenpiValue> RemotePolicy::Ask(
    const std::function<absl::StatusOr<std::string>()>& message) {
  absl::Status lost;
  Monotonic::time_point gone;
  absl::Duration pause = absl::ZeroDuration();  // a server that closes when idle is dialled at once
  for (int attempt = 0; attempt < kAttempts; ++attempt) {
    if (!lost.ok()) {
      absl::SleepFor(pause);
      pause = std::max(kFirstPause, 2 * pause);
      if (const absl::Status dialled = DialAgain(gone, lost); !dialled.ok()) {
        if (!ComesAndGoes(dialled)) return dialled;
        lost = dialled;
        break;
      }
    }
    RS_ASSIGN_OR_RETURN(std::string text, message());
    absl::StatusOr<OpenpiValue> answer = connection_->Ask(
        std::move(text), answered_here_ ? connection_options_.answer_timeout
                                        : connection_options_.first_answer_timeout);
    if (answer.ok() || !ComesAndGoes(answer.status())) return answer;
    lost = answer.status();
    gone = Monotonic::now() + absl::ToChronoNanoseconds(connection_options_.absence);
    // One that never answered will not by being asked again.
    if (absl::IsDeadlineExceeded(lost) && (!answered_ || ++silences_ == 2)) break;
  }
  return absl::UnavailableError(absl::StrCat(
      "the policy at ", url_, " does not answer, after ", reconnections_, " further connections: ",
      lost.message(), "; see the server's log, and run the same command again to go on"));
}

absl::Status RemotePolicy::StartEpisode(const EpisodeKey& key) {
  episode_ = key;
  episode_open_ = episode_begins_ = true;
  const OpenpiDialect& dialect = options_.dialect;
  if (dialect.reset.empty() || dialect.reset_text.empty()) return absl::OkStatus();
  // It is not said again in mid-episode: the server knows us by our session's name, and one that
  // does not has begun anew by itself.
  RS_ASSIGN_OR_RETURN(const OpenpiValue answer, Ask([&]() -> absl::StatusOr<std::string> {
                        std::vector<std::pair<std::string, std::string>> reset = {
                            {dialect.reset, Text(dialect.reset_text)}};
                        if (!dialect.session.empty())
                          reset.emplace_back(dialect.session, SessionText());
                        return MapOf(reset);
                      }));
  return AtServer(OpenpiRefusal(answer));
}

absl::Status RemotePolicy::AtServer(const absl::Status& failed) const {
  if (failed.ok()) return failed;
  std::string remedy = "; see the server's log";
  if (absl::IsInvalidArgument(failed)) {
    absl::StrAppend(&remedy, answered_
                                 ? absl::StrCat(": its first answer had ", spec_.horizon, " rows")
                                 : ", and what remote.execute_steps and remote.action_dim ask");
  }
  return absl::Status(failed.code(), absl::StrCat(address(), ", dialect ", options_.dialect.name,
                                                  ": ", failed.message(), remedy));
}

absl::StatusOr<PredictedChunk> RemotePolicy::Predict(const Observation& observation, int chunk) {
  if (!episode_open_)
    return absl::FailedPreconditionError("no episode is open: StartEpisode first");
  const absl::StatusOr<OpenpiValue> value = Ask([&] {
    if (episode_begins_)
      connection_->BeginEpisode({setting_.suite, episode_, observation.instruction});
    return connection_->Write(observation, Extras(chunk));
  });
  if (absl::IsInternal(value.status()) && !answered_) {
    return absl::InternalError(
        absl::StrCat(value.status().message(),
                     "; where that names a key or a size, choose the model's keys by "
                     "--dialect, its views by remote.cameras and remote.image_size, its state by "
                     "remote.state_dim"));
  }
  RS_RETURN_IF_ERROR(value.status());
  // The first answer says how many rows a chunk has; the others must keep to it.
  const OpenpiSide rows =
      answered_ ? OpenpiSide(spec_.horizon) : OpenpiSide(spec_.execute_steps, WireLimits::kHorizon);
  absl::StatusOr<OpenpiAnswer> answer = ReadOpenpiAnswer(*value, rows, options_.action_dim);
  if (!answer.ok()) return AtServer(answer.status());
  spec_.horizon = static_cast<int>(answer->actions.rows());
  if (answered_here_) silences_ = 0;  // it has time to compile behind a new connection alone
  answered_ = answered_here_ = true;
  episode_begins_ = connection_begins_ = false;
  PredictedChunk predicted;
  predicted.prediction_id = ++predictions_;
  predicted.compute_ms = answer->infer_ms;
  predicted.actions = predicted.policy_actions = predicted.base_actions =
      std::move(answer->actions);
  return predicted;
}

absl::Status RemotePolicy::SendFeedback(ExecutedChunk executed) {
  ++stats_.feedback_chunks;
  if (executed.last_of_episode) connection_->EndEpisode();
  return absl::OkStatus();
}

}  // namespace robostress
