#pragma once

#include <memory>
#include <sstream>
#include <string>

#include "spdlog/sinks/ostream_sink.h"
#include "spdlog/spdlog.h"

namespace robostress {

// What is logged while it lives. No other thread logs when it comes and when it goes.
class HeardLog {
 public:
  HeardLog() { spdlog::default_logger()->sinks().push_back(sink_); }
  ~HeardLog() { spdlog::default_logger()->sinks().pop_back(); }
  std::string words() const { return stream_.str(); }

 private:
  std::ostringstream stream_;
  std::shared_ptr<spdlog::sinks::ostream_sink_mt> sink_ =
      std::make_shared<spdlog::sinks::ostream_sink_mt>(stream_);
};

}  // namespace robostress
