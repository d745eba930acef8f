#include "server/operations/metrics.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(Metrics, ShowsCountersGaugesAndHistogramsInPrometheusTextForm) {
  Metrics metrics;
  metrics.AddCounter("a_total", "What A counts.", {{"policy", "nano"}})->Increment(2);
  metrics.AddGauge("b", "What B is.")->Set(-1.5);
  const auto histogram = metrics.AddHistogram("c_seconds", "How long C takes.", {0.1, 1});
  for (const double value : {0.05, 0.1, 0.5, 7.0}) histogram->Observe(value);
  const std::string text = metrics.Text();
  EXPECT_THAT(text, HasSubstr("# HELP a_total What A counts.\n# TYPE a_total counter\n"
                              "a_total{policy=\"nano\"} 2\n"));
  EXPECT_THAT(text, HasSubstr("# TYPE b gauge\nb -1.5\n"));
  EXPECT_THAT(text, HasSubstr("c_seconds_count 4\n"));
  EXPECT_THAT(text, HasSubstr("c_seconds_bucket{le=\"0.1\"} 2\n"));
  EXPECT_THAT(text, HasSubstr("c_seconds_bucket{le=\"1\"} 3\n"));
  EXPECT_THAT(text, HasSubstr("c_seconds_bucket{le=\"+Inf\"} 4\n"));
}

TEST(Metrics, EscapesWhatAClientNamed) {
  Metrics metrics;
  metrics.AddGauge("g", "help", {{"suite", "a\"b\\c\nd"}})->Set(1);
  EXPECT_THAT(metrics.Text(), HasSubstr("g{suite=\"a\\\"b\\\\c\\nd\"} 1\n"));
}

TEST(Metrics, GivesOneObjectForOneNameAndLabels) {
  Metrics metrics;
  const auto first = metrics.AddCounter("n_total", "help", {{"s", "1"}});
  EXPECT_EQ(first, metrics.AddCounter("n_total", "help", {{"s", "1"}}));
  EXPECT_NE(first, metrics.AddCounter("n_total", "help", {{"s", "2"}}));
  EXPECT_EQ(metrics.size(), 2u);
}

TEST(Metrics, DropsTheSeriesOfASessionThatWasClosed) {
  Metrics metrics;
  const auto kept = metrics.AddGauge("drift", "help", {{"session", "s-1"}, {"axis", "x"}});
  metrics.AddGauge("drift", "help", {{"session", "s-2"}, {"axis", "x"}});
  metrics.Remove("session", "s-1");
  EXPECT_THAT(metrics.Text(), Not(HasSubstr("s-1")));
  EXPECT_THAT(metrics.Text(), HasSubstr("s-2"));
  kept->Set(1);  // whoever still holds it may use it
}

TEST(Metrics, AsksCollectorsBeforeItShows) {
  Metrics metrics;
  metrics.AddCollector([&metrics] { metrics.AddGauge("asked", "help")->Set(4); });
  EXPECT_THAT(metrics.Text(), HasSubstr("asked 4\n"));
}

TEST(Metrics, LosesNothingToThreads) {
  Metrics metrics;
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&metrics] {
      for (int i = 0; i < 10000; ++i) {
        metrics.AddCounter("n_total", "help")->Increment();
        metrics.AddHistogram("h", "help", {1})->Observe(0.5);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(metrics.AddCounter("n_total", "help")->Value(), 40000);
  EXPECT_THAT(metrics.Text(), HasSubstr("h_sum 20000\nh_bucket{le=\"1\"} 40000\n"));
}

TEST(QuantileOf, InterpolatesWithinABucketAndEndsAtTheLastBound) {
  Histogram histogram({1, 2, 4});
  EXPECT_EQ(QuantileOf(histogram, 0.5), 0);
  for (int i = 0; i < 10; ++i) histogram.Observe(1.5);
  EXPECT_DOUBLE_EQ(QuantileOf(histogram, 0.5), 1.5);
  EXPECT_DOUBLE_EQ(QuantileOf(histogram, 1), 2);
  for (int i = 0; i < 10; ++i) histogram.Observe(100);
  EXPECT_DOUBLE_EQ(QuantileOf(histogram, 0.99), 4);
}

}  // namespace
}  // namespace robostress
