#include "server/pages/operations_pages.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

class OperationsPagesTest : public ::testing::Test {
 protected:
  OperationsPagesTest() : telemetry_(&metrics_), traces_(&metrics_) {
    figures_.id = "session-1";
    figures_.spec.suite = "tabletop_goal";
    figures_.spec.scenario = "heavy<payload>";
    figures_.spec.policy = "nano";
    figures_.spec.method = *MakeMethod("ours");
    sources_.metrics = &metrics_;
    sources_.traces = &traces_;
    sources_.telemetry = &telemetry_;
    sources_.tokens = tokens_;
    sources_.figures = [this] { return std::vector<SessionFigures>{figures_}; };
    sources_.server = [] { return LiveServer{"nano 3f2a", "4m", false, true}; };
    sources_.ready = [this] { return ready_; };
  }

  WebReply Get(const std::string& path, const std::string& query = "",
               const std::string& authorization = "") {
    return OperationsPage({path, query, authorization, "127.0.0.1:1"}, sources_);
  }

  // One step of which x was commanded 1 and reached 0.5, z was commanded and reached 0.
  static Eigen::MatrixXd Missed() { return -0.5 * Eigen::MatrixXd::Identity(1, 7); }
  static std::shared_ptr<const Observation> Seen() {
    Observation observation;
    observation.views.push_back({"wrist camera", Image{2, 2, std::vector<uint8_t>(12, 200)}});
    return std::make_shared<const Observation>(std::move(observation));
  }

  Metrics metrics_;
  Telemetry telemetry_;
  TraceLog traces_;
  const std::shared_ptr<TokenStore> tokens_ = std::make_shared<TokenStore>();
  SessionFigures figures_;
  bool ready_ = true;
  OperationsSources sources_;
};

TEST_F(OperationsPagesTest, ShowsResidualsDriftAndOutcomesAsMetrics) {
  telemetry_.Reported("session-1", figures_.spec, 1, Missed());
  telemetry_.Predicted("session-1", Seen(), 0.02);
  figures_.adapter_distance = 0.25;
  figures_.updates_applied = 3;
  figures_.updates_refused = 1;
  std::string text = Get("/metrics").body;
  EXPECT_THAT(text,
              HasSubstr("robostress_session_residual{session=\"session-1\",axis=\"x\"} 0.5\n"));
  EXPECT_THAT(text, HasSubstr("robostress_session_residual{session=\"session-1\",axis=\"z\"} 0\n"));
  EXPECT_THAT(text, HasSubstr("robostress_residual_bucket{axis=\"x\",le=\"0.5\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("robostress_adapter_distance{session=\"session-1\"} 0.25\n"));
  EXPECT_THAT(text, HasSubstr("robostress_adapter_version{session=\"session-1\"} 3\n"));
  EXPECT_THAT(text, HasSubstr("robostress_updates_total{outcome=\"applied\"} 3\n"));
  EXPECT_THAT(text, HasSubstr("robostress_updates_total{outcome=\"refused\"} 1\n"));
  EXPECT_THAT(text, HasSubstr("robostress_sessions{state=\"open\"} 1\n"));
  figures_.updates_applied = 5;
  EXPECT_THAT(Get("/metrics").body, HasSubstr("robostress_updates_total{outcome=\"applied\"} 5\n"));
  // The session ends: its series go, what it counted stays.
  sources_.figures = [] { return std::vector<SessionFigures>(); };
  text = Get("/metrics").body;
  EXPECT_THAT(text, Not(HasSubstr("session-1")));
  EXPECT_THAT(text, HasSubstr("robostress_updates_total{outcome=\"applied\"} 5\n"));
}

TEST_F(OperationsPagesTest, ShowsSessionsWithPlotsAndImagesAndEscapesTheirNames) {
  for (uint64_t i = 1; i <= 300; ++i) telemetry_.Reported("session-1", figures_.spec, i, Missed());
  telemetry_.Predicted("session-1", Seen(), 0.02);
  const WebReply page = Get("/");
  EXPECT_EQ(page.status, 200);
  EXPECT_THAT(page.body, HasSubstr("heavy&lt;payload&gt;"));
  EXPECT_THAT(page.body, Not(HasSubstr("heavy<payload>")));
  EXPECT_THAT(page.body, HasSubstr("mean |residual|"));
  EXPECT_THAT(page.body, HasSubstr("/image?session=session-1&amp;camera=wrist%20camera&amp;n=1"));
  const WebReply image = Get("/image", "session=session-1&camera=wrist%20camera&n=1");
  EXPECT_EQ(image.content_type, "image/png");
  EXPECT_EQ(image.body.substr(1, 3), "PNG");
  EXPECT_EQ(Get("/image", "session=session-1&camera=none").status, 404);
  EXPECT_EQ(telemetry_.Views()[0].residuals.size(), Telemetry::kHistory);
  EXPECT_THAT(Get("/main").body, HasSubstr("<main"));
  EXPECT_EQ(Get("/live.js").content_type, "text/javascript; charset=utf-8");
  EXPECT_TRUE(nlohmann::json::parse(Get("/traces").body).contains("traceEvents"));
  EXPECT_EQ(Get("/else").status, 404);
}

TEST_F(OperationsPagesTest, ShowsNoNumberWhereThereIsNone) {
  const std::string page = Get("/").body;
  EXPECT_THAT(page, Not(HasSubstr("0 ms")));
  EXPECT_THAT(page, Not(HasSubstr("0.0 / 0.0")));
  EXPECT_THAT(page, HasSubstr("<td>\u2013</td><td>\u2013</td><td>\u2013</td></tr>"));
  figures_.updates_applied = 1;
  figures_.adapter_distance = 0.25;
  figures_.last_loss = 0.5;
  EXPECT_THAT(Get("/").body, HasSubstr("<td>0.25</td><td>0.5</td>"));
}

TEST_F(OperationsPagesTest, LatenciesAreReadable) {
  telemetry_.Predicted("session-1", Seen(), 1.7);
  metrics_.AddCounter("robostress_predictions_answered_total", "")->Increment();
  metrics_.AddHistogram("robostress_predict_seconds", "", LatencyBounds())->Observe(1.7);
  const std::string page = Get("/").body;
  EXPECT_THAT(page, HasSubstr(" ms</b>"));
  EXPECT_THAT(page, Not(HasSubstr("e+03 ms")));
}

TEST_F(OperationsPagesTest, SessionsInUseKeepTheirPlaces) {
  const auto order = [this](double first_s, double second_s) {
    std::vector<SessionFigures> both = {figures_, figures_};
    both[1].id = "session-2";
    both[0].idle_s = first_s;
    both[1].idle_s = second_s;
    sources_.figures = [both] { return both; };
    const std::string body = Get("/main").body;
    return body.find("session-1") < body.find("session-2");
  };
  EXPECT_TRUE(order(0.1, 0.2));
  EXPECT_TRUE(order(0.2, 0.1));
  EXPECT_FALSE(order(300, 200));  // others: the one used last first
}

TEST_F(OperationsPagesTest, ALongHistoryIsDrawnAsMeansOfChunks) {
  for (uint64_t i = 1; i <= 60; ++i) telemetry_.Reported("session-1", figures_.spec, i, Missed());
  EXPECT_THAT(Get("/").body, HasSubstr("executed chunk<"));
  telemetry_.Reported("session-1", figures_.spec, 61, Missed());
  EXPECT_THAT(Get("/").body, HasSubstr("executed chunk, a point is the mean of 2<"));
}

TEST_F(OperationsPagesTest, ThePageIsRefreshedUnderAnAddressWithAPasswordToo) {
  // A browser refuses to fetch relative to such an address.
  EXPECT_THAT(Get("/live.js").body, HasSubstr("fetch(location.origin + '/main')"));
}

TEST_F(OperationsPagesTest, RemembersABoundedNumberOfSessionsWhereNobodyAsks) {
  for (int i = 0; i < 1000; ++i) telemetry_.Predicted(absl::StrCat("session-", i), Seen(), 0.02);
  std::vector<SessionFigures> all;
  for (int i = 0; i < 1000; ++i) {
    all.push_back(figures_);
    all.back().id = absl::StrCat("session-", i);
  }
  telemetry_.Refresh(all);
  size_t with_images = 0;
  for (const Telemetry::View& view : telemetry_.Views()) with_images += !view.cameras.empty();
  EXPECT_EQ(with_images, Telemetry::kUnlisted);
  // What a session did since it was last asked is counted when it closes.
  SessionFigures last;
  last.updates_applied = 7;
  telemetry_.Forget("session-999", &last);
  EXPECT_THAT(metrics_.Text(), HasSubstr("robostress_updates_total{outcome=\"applied\"} 7\n"));
  EXPECT_EQ(telemetry_.Views().size(), 999u);
  EXPECT_THAT(metrics_.Text(), Not(HasSubstr("session-999")));
}

TEST_F(OperationsPagesTest, FollowsTheDriftOfAnAdapterWhoeverLooks) {
  for (uint64_t version : {0, 0, 1, 1, 2})
    telemetry_.Adapted("session-1", {version, 0.1 * double(version), 1});
  figures_.id = "session-1";
  figures_.updates_applied = 2;
  telemetry_.Refresh({figures_});
  const std::vector<Telemetry::DriftPoint> drift = telemetry_.Views()[0].drift;
  ASSERT_EQ(drift.size(), 3u);
  for (size_t i = 0; i < drift.size(); ++i) EXPECT_EQ(drift[i].version, i);
}

TEST_F(OperationsPagesTest, IsReadyOnlyWhileTheServerIs) {
  EXPECT_EQ(Get("/readyz").status, 200);
  ready_ = false;
  EXPECT_EQ(Get("/readyz").status, 503);
  EXPECT_EQ(Get("/healthz").status, 200);
}

TEST_F(OperationsPagesTest, AProbesPortShowsNothingElse) {
  const auto ready = [this] { return ready_; };
  const auto get = [&](const char* path) { return HealthPage({path, "", "", ""}, ready).status; };
  EXPECT_EQ(get("/healthz"), 200);
  EXPECT_EQ(get("/readyz"), 200);
  ready_ = false;
  EXPECT_EQ(get("/healthz"), 200);
  EXPECT_EQ(get("/readyz"), 503);
  for (const char* path : {"/", "/main", "/metrics", "/traces", "/image", "/live.js", "/healthz/"})
    EXPECT_EQ(get(path), 404) << path;
}

TEST_F(OperationsPagesTest, ShowsNothingButHealthWithoutTheAdminScope) {
  tokens_->Set(*AccessTokens::Parse(
      "t", absl::StrCat("tokens: [{name: arm, sha256: ", Sha256Hex("arm"),
                        ", scopes: [predict]}, {name: op, sha256: ", Sha256Hex("op"),
                        ", scopes: [admin]}, {name: prometheus, sha256: ", Sha256Hex("prometheus"),
                        ", scopes: [metrics]}]")));
  for (const char* path : {"/", "/main", "/metrics", "/traces", "/image", "/live.js", "/else"}) {
    EXPECT_EQ(Get(path).status, 401) << path;
    EXPECT_EQ(Get(path, "", "Bearer arm").status, 403) << path;
  }
  EXPECT_EQ(Get("/metrics", "", "Bearer op").status, 200);
  // Who reads figures sees no images, instructions or spans.
  EXPECT_EQ(Get("/metrics", "", "Bearer prometheus").status, 200);
  for (const char* path : {"/", "/main", "/traces", "/image", "/live.js", "/else"})
    EXPECT_EQ(Get(path, "", "Bearer prometheus").status, 403) << path;
  EXPECT_EQ(Get("/healthz").status, 200);
  EXPECT_EQ(Get("/readyz").status, 200);
}

}  // namespace
}  // namespace robostress
