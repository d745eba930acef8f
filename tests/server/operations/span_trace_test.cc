#include "server/operations/span_trace.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "nlohmann/json.hpp"

namespace robostress {
namespace {

TEST(StageTimer, AddsToTheTraceOfItsThreadAndNothingOutsideOfOne) {
  { const StageTimer nowhere("encode"); }
  const auto trace = std::make_shared<PredictionTrace>("session-1", 0, 3, 12);
  {
    const TraceScope scope(trace);
    const StageTimer timer("encode");
    std::thread([] { const StageTimer other("sample"); }).join();  // has no trace of its own
  }
  EXPECT_EQ(PredictionTrace::Current(), nullptr);
  ASSERT_EQ(trace->spans().size(), 1u);
  EXPECT_STREQ(trace->spans()[0].stage, "encode");
  EXPECT_LE(trace->spans()[0].begin, trace->spans()[0].end);
}

TEST(TraceLog, KeepsTheLastPredictionsAndTimesEveryStage) {
  Metrics metrics;
  TraceLog log(&metrics);
  for (int i = 0; i < 300; ++i) {
    auto trace = std::make_shared<PredictionTrace>(i % 2 == 0 ? "even" : "odd\xff", 0, 0, i);
    const auto begin = PredictionTrace::Clock::now();
    trace->Add("sample", begin, begin + std::chrono::milliseconds(4));
    log.Finish(trace);
  }
  const auto histogram =
      metrics.AddHistogram("robostress_stage_seconds", "", {}, {{"stage", "sample"}});
  EXPECT_NEAR(histogram->Collect().histogram.sample_sum, 300 * 0.004, 1e-9);
  const auto json = nlohmann::json::parse(log.Json());
  size_t spans = 0, sessions = 0;
  for (const auto& event : json["traceEvents"]) {
    spans += event["ph"] == "X";
    sessions += event["ph"] == "M";
    if (event["ph"] == "X") {
      EXPECT_NEAR(event["dur"].get<double>(), 4000, 1e-6);
    }
  }
  EXPECT_EQ(spans, 256u);
  EXPECT_EQ(sessions, 2u);
}

}  // namespace
}  // namespace robostress
