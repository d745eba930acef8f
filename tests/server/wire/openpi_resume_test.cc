// A client of openpi's wire whose connections and servers end under it, against one whose do not.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <optional>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/wire/openpi_connection.h"
#include "common/wire/openpi_readers.h"
#include "server/web_endpoints.h"
#include "server/wire/grpc/policy_service.h"
#include "tests/common/wire/openpi_bytes.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// A policy server with its WebSocket.
class Served {
 public:
  explicit Served(const std::string& state_dir) {
    PolicyServerOptions options;
    options.threads = 1;
    options.state_dir = state_dir;
    options.caps.min_update_interval = 1;
    auto started = PolicyServer::Start(options, {std::make_shared<FakePolicy>()});
    EXPECT_TRUE(started.ok()) << started.status();
    server_ = *std::move(started);
    WebEndpointsOptions web;
    web.websocket_listen = "127.0.0.1:0";
    web.openpi.session.robot = web.openpi.session.suite = "openpi";
    web.openpi.session.scenario = "unknown";
    web.openpi.session.mode = ExecutionMode::kAsync;
    web.openpi.session.method = *MakeMethod("base");
    web.openpi.session.control_space = ControlSpace::kEndEffector;
    auto endpoints = WebEndpoints::Start(web, server_.get());
    EXPECT_TRUE(endpoints.ok()) << endpoints.status();
    web_ = *std::move(endpoints);
  }
  int port() const { return web_->websocket_port(); }
  std::string ExportOf(const std::string& id) {
    const auto session = server_->sessions().Use(id);
    EXPECT_TRUE(session.ok()) << session.status();
    return robostress::ExportOf(**session);
  }
  // The session's own adapter, imported into it.
  std::optional<EpisodeKey> ImportInto(const std::string& id) {
    const auto session = server_->sessions().Use(id);
    EXPECT_TRUE((*session)->Import(robostress::ExportOf(**session)).ok());
    return (*session)->Position().episode;
  }
  std::optional<EpisodeKey> EpisodeOf(const std::string& id) {
    return (*server_->sessions().Use(id))->Position().episode;
  }

 private:
  std::unique_ptr<PolicyServer> server_;
  std::unique_ptr<WebEndpoints> web_;
};

// A robot that sees where it is, does what it was told, and reports it.
class Robot {
 public:
  explicit Robot(int port) { Connect(port); }

  void Connect(int port) {
    client_.reset();
    auto connected = OpenpiConnection::Connect(absl::StrCat("ws://127.0.0.1:", port));
    ASSERT_TRUE(connected.ok()) << connected.status();
    client_ = *std::move(connected);
    first_ = true;
  }
  void Predict() {
    OpenpiBytes message;
    message.Map((first_ ? 3 : 2) + (first_ && id_.empty() ? 1 : 0));
    if (first_) Session(message);
    message.Text("prompt").Text("put the bowl on the plate");
    message.Text("observation/state").Numbers<double>("<f8", {3}, {p_[0], p_[1], p_[2]});
    const std::string payload = Exchange(message);
    const auto reply = DecodeOpenpi(payload);
    ASSERT_TRUE(reply.ok()) << payload;
    const auto actions = OpenpiMatrix("actions", *reply->Find("actions"), 10, 7);
    ASSERT_TRUE(actions.ok()) << actions.status();
    actions_ = *actions;
    const OpenpiValue& adapter = *reply->Find("adapter");
    id_ = std::get<std::string_view>(adapter.Find("session")->value);
    prediction_ = std::get<int64_t>(adapter.Find("prediction_id")->value);
    if (const OpenpiValue* token = adapter.Find("resume_token"))
      token_ = std::get<std::string_view>(token->value);
  }
  // What becomes of five steps of the last reply; `later` steps into it.
  void Execute(int first_step) {
    first_step_ = first_step;
    path_.assign(1, p_);
    for (int i = 0; i < 5; ++i) {
      p_ += 0.05 * 0.6 * actions_.row(first_step + i).head<3>().transpose();
      path_.push_back(p_);
    }
    ++sequence_;
  }
  // Whether it was in already.
  bool Report(std::optional<int64_t> prediction = {}) {
    OpenpiBytes message;
    message.Map(first_ ? 2 : 1);
    if (first_) Session(message);
    std::vector<double> p;
    for (const Eigen::Vector3d& at : path_) p.insert(p.end(), at.data(), at.data() + 3);
    message.Text("executed").Map(5).Text("sequence").Integer(sequence_);
    message.Text("prediction_id").Integer(static_cast<uint64_t>(prediction.value_or(prediction_)));
    message.Text("first_step").Integer(static_cast<uint64_t>(first_step_));
    message.Text("q").Numbers<double>("<f8", {6, 7}, std::vector<double>(42, 0.25));
    message.Text("p_base_tool").Numbers<double>("<f8", {6, 3}, p);
    const std::string payload = Exchange(message);
    const auto reply = DecodeOpenpi(payload);
    EXPECT_TRUE(reply.ok()) << payload;
    if (!reply.ok()) return false;
    const OpenpiValue& feedback = *reply->Find("feedback");
    EXPECT_EQ(std::get<int64_t>(feedback.Find("sequence")->value), static_cast<int64_t>(sequence_));
    return std::get<bool>(feedback.Find("duplicate")->value);
  }
  const std::string& id() const { return id_; }
  const Eigen::Vector3d& p() const { return p_; }
  const Eigen::MatrixXd& actions() const { return actions_; }

 private:
  std::string Exchange(const OpenpiBytes& message) {
    first_ = false;
    const auto answer = client_->Ask(message.bytes(), absl::Seconds(30));
    return answer.ok() ? *answer : std::string(answer.status().message());
  }
  void Session(OpenpiBytes& message) const {
    message.Text("session");
    if (!id_.empty()) {
      message.Map(1).Text("resume").Map(2).Text("id").Text(id_).Text("token").Text(token_);
      return;  // no word of the episode
    }
    message.Map(4).Text("method").Text("ours").Text("mode").Text("lockstep");
    message.Text("control_period_s").Numbers<double>("<f8", {1}, {0.1});
    message.Text("method_options").Byte(0x94).Text(kRate).Text("buffer_chunks=4");
    message.Text("update_interval=2").Text("batch=2");
    message.Text("episode").Map(2).Text("task").Integer(3).Text("episode").Integer(2);
  }

  std::unique_ptr<OpenpiConnection> client_;
  bool first_ = true;
  std::string id_, token_;
  int64_t prediction_ = 0;
  uint64_t sequence_ = 0;
  int first_step_ = 0;
  Eigen::MatrixXd actions_;
  Eigen::Vector3d p_ = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> path_;
};

class OpenpiResume : public ::testing::Test {
 protected:
  OpenpiResume() : root_(fs::path(::testing::TempDir()) / absl::StrCat("resume-", getpid())) {
    fs::remove_all(root_);
    fs::create_directories(root_);
  }
  ~OpenpiResume() override { fs::remove_all(root_); }
  const fs::path root_;
};

constexpr int kChunks = 24;

std::string WithoutInterruption(Robot& robot, Served& served) {
  for (int i = 0; i < kChunks; ++i) {
    robot.Predict();
    for (const int first_step : {0, 5}) {
      robot.Execute(first_step);
      robot.Report();
    }
  }
  return served.ExportOf(robot.id());
}

TEST_F(OpenpiResume, GoesOnBitForBitOnAnotherConnection) {
  Served served("");
  Robot straight(served.port()), cut(served.port());
  const std::string expected = WithoutInterruption(straight, served);
  for (int i = 0; i < kChunks; ++i) {
    cut.Predict();
    cut.Execute(0);
    if (i % 3 == 0) cut.Connect(served.port());  // between the reply and the report
    EXPECT_FALSE(cut.Report());
    if (i % 4 == 0) {  // the report's answer was lost
      cut.Connect(served.port());
      EXPECT_TRUE(cut.Report());
      EXPECT_TRUE(cut.Report(/*prediction=*/1000));
    }
    cut.Execute(5);  // the rest of the same reply
    EXPECT_FALSE(cut.Report());
    if (i % 5 == 0) cut.Connect(served.port());  // before the next observation
  }
  EXPECT_EQ(cut.actions(), straight.actions());
  EXPECT_EQ(served.ExportOf(cut.id()), expected);
}

TEST_F(OpenpiResume, AfterAnImportTheFirstEpisodeOfItsTaskBegins) {
  Served served((root_ / "state").string());
  Robot robot(served.port());
  robot.Predict();
  EXPECT_EQ(served.ImportInto(robot.id()), (EpisodeKey{3, -1}));
  robot.Connect(served.port());
  robot.Predict();
  EXPECT_EQ(served.EpisodeOf(robot.id()), (EpisodeKey{3, 0}));
}

TEST_F(OpenpiResume, GoesOnBitForBitOnAServerThatWasStartedAgain) {
  Served memory("");
  Robot straight(memory.port());
  const std::string expected = WithoutInterruption(straight, memory);
  std::string folder = (root_ / "0").string();
  std::optional<Served> served(std::in_place, folder);
  Robot cut(served->port());
  int restarts = 0;
  const auto restart = [&](bool orderly) {
    ++restarts;
    if (!orderly) {  // what a crash leaves: the disk as it is now
      const std::string left = (root_ / absl::StrCat(restarts)).string();
      fs::copy(folder, left, fs::copy_options::recursive);
      folder = left;
    }
    served.reset();
    served.emplace(folder);
    cut.Connect(served->port());
  };
  for (int i = 0; i < kChunks; ++i) {
    cut.Predict();
    cut.Execute(0);
    if (i % 3 == 0) restart(i % 2 == 0);
    EXPECT_FALSE(cut.Report());
    cut.Execute(5);
    if (i % 4 == 0) restart(i % 8 == 0);
    EXPECT_FALSE(cut.Report());
    if (i % 5 == 0) {
      restart(i % 2 == 1);
      EXPECT_TRUE(cut.Report());
    }
  }
  EXPECT_GT(restarts, 15);
  EXPECT_EQ(cut.actions(), straight.actions());
  EXPECT_EQ(served->ExportOf(cut.id()), expected);
}

}  // namespace
}  // namespace robostress
