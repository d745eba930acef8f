#include "server/operations/json_log.h"

#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <memory>

#include "absl/strings/str_cat.h"
#include "absl/time/time.h"
#include "nlohmann/json.hpp"
#include "server/operations/span_trace.h"

namespace robostress {
namespace {

// Runs on the thread that logs, so that the current trace is the one of what is logged.
class JsonFormatter : public spdlog::formatter {
 public:
  void format(const spdlog::details::log_msg& message, spdlog::memory_buf_t& line) override {
    const auto level = spdlog::level::to_string_view(message.level);
    nlohmann::ordered_json json = {
        {"time", absl::FormatTime("%Y-%m-%dT%H:%M:%E3SZ", absl::FromChrono(message.time),
                                  absl::UTCTimeZone())},
        {"level", std::string(level.data(), level.size())},
        {"message", std::string(message.payload.data(), message.payload.size())},
        {"thread", message.thread_id}};
    if (const auto& trace = PredictionTrace::Current(); trace != nullptr) {
      json["session"] = trace->session();
      json["step"] = trace->step();
    }
    const std::string text =
        json.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace) + "\n";
    line.append(text.data(), text.data() + text.size());
  }
  std::unique_ptr<spdlog::formatter> clone() const override {
    return std::make_unique<JsonFormatter>();
  }
};

// "[2026-01-01 12:00:00.000] [info] [session-1 task 0 episode 0 chunk 3] message"
class StepFlag : public spdlog::custom_flag_formatter {
 public:
  void format(const spdlog::details::log_msg&, const std::tm&, spdlog::memory_buf_t& out) override {
    const auto& trace = PredictionTrace::Current();
    if (trace == nullptr) return;
    const std::string text = absl::StrCat("[", trace->session(), " ", trace->step(), "] ");
    out.append(text.data(), text.data() + text.size());
  }
  std::unique_ptr<custom_flag_formatter> clone() const override {
    return std::make_unique<StepFlag>();
  }
};

}  // namespace

absl::Status SetUpLog(const std::string& format, const std::string& level) {
  const spdlog::level::level_enum parsed = spdlog::level::from_str(level);
  if (parsed == spdlog::level::off && level != "off") {
    return absl::InvalidArgumentError(
        absl::StrCat("--log-level is '", level, "', must be debug, info, warn, error or off"));
  }
  std::unique_ptr<spdlog::formatter> formatter;
  if (format == "json") {
    formatter = std::make_unique<JsonFormatter>();
  } else if (format == "text") {
    auto pattern = std::make_unique<spdlog::pattern_formatter>();
    pattern->add_flag<StepFlag>('*').set_pattern("[%Y-%m-%d %H:%M:%S.%e] [%l] %*%v");
    formatter = std::move(pattern);
  } else {
    return absl::InvalidArgumentError(
        absl::StrCat("--log-format is '", format, "', must be text or json"));
  }
  auto logger =
      std::make_shared<spdlog::logger>("serve", std::make_shared<spdlog::sinks::stderr_sink_mt>());
  logger->set_formatter(std::move(formatter));
  logger->set_level(parsed);
  logger->flush_on(spdlog::level::info);
  spdlog::set_default_logger(std::move(logger));
  return absl::OkStatus();
}

}  // namespace robostress
