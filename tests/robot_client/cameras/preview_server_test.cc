#include "robot_client/cameras/preview_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/asio/connect.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core.hpp>
#include <boost/beast/http.hpp>

#include "nlohmann/json.hpp"
#include "robot_client/cameras/faulty_source.h"
#include "robot_client/cameras/jpeg.h"
#include "robot_client/cameras/synthetic_source.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;

using Response = http::response<http::string_body>;

struct Shown {
  MonotonicClock clock;
  FaultySource wrist{std::make_unique<SyntheticSource>(SyntheticSourceOptions{"wrist"}, &clock),
                     &clock};
  SyntheticSource base{{"base", 128, 96, 10}, &clock};
  std::unique_ptr<PreviewServer> server;
  asio::io_context context;
  beast::tcp_stream stream{context};

  Shown() {
    EXPECT_TRUE(wrist.Start().ok() && base.Start().ok());
    auto started = PreviewServer::Start({"127.0.0.1:0"}, {&wrist, &base}, &clock);
    EXPECT_TRUE(started.ok()) << started.status();
    server = *std::move(started);
    stream.connect({asio::ip::make_address("127.0.0.1"), static_cast<uint16_t>(server->port())});
  }
  // All on one connection, as a browser asks.
  Response Get(const std::string& target, const std::string& host = "127.0.0.1",
               http::verb verb = http::verb::get) {
    http::request<http::empty_body> request{verb, target, 11};
    request.set(http::field::host, host);
    http::write(stream, request);
    beast::flat_buffer buffer;
    Response response;
    http::read(stream, buffer, response);
    return response;
  }
  nlohmann::json Cameras() { return nlohmann::json::parse(Get("/cameras.json").body()); }
  void Sleep(int64_t ms) { clock.SleepUntil(clock.now_ns() + ms * 1'000'000); }
};

TEST(PreviewServerTest, ShowsTheNewestPictureOfEachCameraWithItsAgeSizeAndRate) {
  Shown shown;
  shown.Sleep(1200);
  const nlohmann::json cameras = shown.Cameras();
  ASSERT_EQ(cameras.size(), 2u);
  EXPECT_EQ(cameras[0]["name"], "wrist");
  EXPECT_EQ(cameras[1]["width"], 128);
  EXPECT_EQ(cameras[1]["height"], 96);
  EXPECT_NEAR(cameras[0]["rate_hz"].get<double>(), 30, 2);
  EXPECT_NEAR(cameras[1]["rate_hz"].get<double>(), 10, 1);
  EXPECT_GE(cameras[0]["age_ms"].get<double>(), 10);
  EXPECT_LT(cameras[0]["age_ms"].get<double>(), 150);
  const Response picture = shown.Get("/picture/1.jpg?7");
  EXPECT_EQ(picture[http::field::content_type], "image/jpeg");
  const auto image = RgbFromJpeg(picture.body());
  ASSERT_TRUE(image.ok()) << image.status();
  EXPECT_EQ(image->width, 128);
  EXPECT_GE(*SequenceIn(*image), 10u);
  EXPECT_THAT(shown.Get("/").body(), HasSubstr("/cameras.json"));
}

TEST(PreviewServerTest, ACameraThatStopsGrowsOldAndSaysWhy) {
  Shown shown;
  shown.Sleep(200);
  shown.wrist.Set(CameraFault::kUnplug);
  shown.Sleep(600);
  const nlohmann::json cameras = shown.Cameras();
  EXPECT_GT(cameras[0]["age_ms"].get<double>(), 550);
  EXPECT_THAT(cameras[0]["status"].get<std::string>(), HasSubstr("unplugged"));
  EXPECT_LT(cameras[1]["age_ms"].get<double>(), 500);
}

TEST(PreviewServerTest, AnswersNothingElseAndNoForeignName) {
  Shown shown;
  EXPECT_EQ(shown.Get("/../etc/passwd").result(), http::status::not_found);
  EXPECT_EQ(shown.Get("/picture/2.jpg").result(), http::status::not_found);
  EXPECT_EQ(shown.Get("/picture/x.jpg").result(), http::status::not_found);
  EXPECT_EQ(shown.Get("/", "localhost:8090").result(), http::status::ok);
  EXPECT_EQ(shown.Get("/", "evil.example").result(), http::status::misdirected_request);
  EXPECT_EQ(shown.Get("/", "127.0.0.1", http::verb::delete_).result(),
            http::status::method_not_allowed);
}

TEST(PreviewServerTest, ListensOnThisMachineOnlyUnlessAsked) {
  MonotonicClock clock;
  const auto refused = PreviewServer::Start({"0.0.0.0:0"}, {}, &clock);
  EXPECT_THAT(std::string(refused.status().message()), HasSubstr("--anywhere"));
  for (const char* text : {"", "8090", "here:8090", "127.0.0.1:x", "127.0.0.1:70000"}) {
    EXPECT_THAT(std::string(PreviewServer::Start({text}, {}, &clock).status().message()),
                HasSubstr("127.0.0.1:8090"));
  }
  const auto first = PreviewServer::Start({"127.0.0.1:0"}, {}, &clock);
  ASSERT_TRUE(first.ok());
  const auto second =
      PreviewServer::Start({"127.0.0.1:" + std::to_string((*first)->port())}, {}, &clock);
  EXPECT_THAT(std::string(second.status().message()), HasSubstr("choose another port"));
}

}  // namespace
}  // namespace robostress
