// Who may do what over gRPC, and when the server says that it is ready.
#include <gmock/gmock.h>
#include <google/protobuf/descriptor.h>
#include <grpcpp/generic/async_generic_service.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <chrono>
#include <filesystem>
#include <thread>

#include "absl/strings/str_cat.h"
#include "absl/synchronization/notification.h"
#include "common/atomic_file.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_specs.h"
#include "common/rpc/policy_client.h"
#include "common/wire/openpi_connection.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/operations/access_table.h"
#include "server/sessions/read_spec.h"
#include "server/web_endpoints.h"
#include "server/wire/grpc/admin_server.h"
#include "server/wire/grpc/grpc_access.h"
#include "server/wire/grpc/policy_service.h"
#include "tests/run_program.h"
#include "tests/server/operations/test_certificates.h"
#include "tests/server/sessions/drive.h"
#include "tests/server/wire/tls_web_client.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

struct Answer {
  grpc::Status status;
  std::string bytes;
};

// Any method with any message; `token` empty: none is shown. Streams are half-closed at once.
Answer Call(const std::shared_ptr<grpc::Channel>& channel, const std::string& method,
            const std::string& request, const std::string& token = "") {
  grpc::GenericStub stub(channel);
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(20));
  if (!token.empty()) context.AddMetadata("authorization", absl::StrCat("Bearer ", token));
  grpc::CompletionQueue queue;
  const grpc::Slice slice(request);
  auto call = stub.PrepareUnaryCall(&context, method, grpc::ByteBuffer(&slice, 1), &queue);
  call->StartCall();
  grpc::ByteBuffer response;
  Answer answer;
  call->Finish(&response, &answer.status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  queue.Next(&tag, &ok);
  grpc::Slice bytes;
  if (answer.status.ok() && response.DumpToSingleSlice(&bytes).ok())
    answer.bytes.assign(reinterpret_cast<const char*>(bytes.begin()), bytes.size());
  return answer;
}

AccessTokens Tokens() {
  std::string file = "tokens:\n";
  for (const auto& [name, scopes] : {std::pair("predict", "predict"),
                                     {"feedback", "feedback"},
                                     {"arm", "predict, feedback"},
                                     {"other", "predict, feedback"},
                                     {"prometheus", "metrics"},
                                     {"operator", "admin"}})
    absl::StrAppend(&file, "  - {name: ", name, ", sha256: ", Sha256Hex(name), ", scopes: [",
                    scopes, "]}\n");
  return *AccessTokens::Parse("tokens.yaml", file);
}

std::shared_ptr<grpc::Channel> Plain(int port) {
  return grpc::CreateChannel(absl::StrCat("127.0.0.1:", port), grpc::InsecureChannelCredentials());
}

class ServingSecurityTest : public ::testing::Test {
 protected:
  void Start(const PolicyServerOptions& options) {
    auto server = PolicyServer::Start(options, {std::make_shared<FakePolicy>()});
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
  }
  void StartAdmin() {
    AdminServerOptions options;
    options.drain = [this](absl::Duration grace) {
      drained_ = grace;
      server_->Drain();
    };
    auto admin =
        AdminServer::Start(options, &server_->sessions(), server_->tokens(), &server_->metrics());
    ASSERT_TRUE(admin.ok()) << admin.status();
    admin_ = *std::move(admin);
  }
  std::string OpenRequest() const {
    v1::OpenSessionRequest request;
    *request.mutable_spec() = ToProto(RequestOf(Spec("ours")));
    return request.SerializeAsString();
  }
  std::string Open() {
    const Answer answer = Call(Plain(server_->port()), "/robostress.v1.PolicyService/OpenSession",
                               OpenRequest(), "arm");
    EXPECT_TRUE(answer.status.ok()) << answer.status.error_message();
    v1::OpenSessionResponse response;
    response.ParseFromString(answer.bytes);
    return response.session_id();
  }

  std::unique_ptr<PolicyServer> server_;
  std::unique_ptr<AdminServer> admin_;
  absl::Duration drained_ = absl::InfiniteDuration();
};

// Every method that the schema has, now and later.
TEST_F(ServingSecurityTest, NoMethodAnswersWithoutATokenOrWithOneOfNoUse) {
  PolicyServerOptions options;
  options.tokens = std::make_shared<TokenStore>(Tokens());
  Start(options);
  StartAdmin();
  const std::string id = Open();
  const std::string adapter = ExportOf(**server_->sessions().Use(id));
  int methods = 0;
  for (const char* name : {"PolicyService", "AdminService"}) {
    const bool is_admin = std::string(name) == "AdminService";
    const auto* service = google::protobuf::DescriptorPool::generated_pool()->FindServiceByName(
        absl::StrCat("robostress.v1.", name));
    ASSERT_NE(service, nullptr);
    const auto channel = Plain(is_admin ? admin_->port() : server_->port());
    v1::CloseSessionRequest with_id;  // session_id is field 1 of every request that has one
    const auto names_session = [](const google::protobuf::Descriptor* request) {
      const auto* field = request->FindFieldByName("session_id");
      return field != nullptr && field->number() == 1;
    };
    with_id.set_session_id(id);
    for (int i = 0; i < service->method_count(); ++i, ++methods) {
      const std::string method =
          absl::StrCat("/", service->full_name(), "/", service->method(i)->name());
      const std::string request = names_session(service->method(i)->input_type())
                                      ? with_id.SerializeAsString()
                                      : std::string();
      EXPECT_EQ(Call(channel, method, request).status.error_code(),
                grpc::StatusCode::UNAUTHENTICATED)
          << method;
      EXPECT_EQ(Call(channel, method, request, "guess").status.error_code(),
                grpc::StatusCode::UNAUTHENTICATED)
          << method;
      for (const char* token : {is_admin ? "arm" : "operator", "prometheus"}) {
        EXPECT_EQ(Call(channel, method, request, token).status.error_code(),
                  grpc::StatusCode::PERMISSION_DENIED)
            << method << " " << token;
      }
    }
  }
  EXPECT_GE(methods, 18);
  // A probe has no token.
  EXPECT_TRUE(Call(Plain(server_->port()), "/grpc.health.v1.Health/Check", "").status.ok());
  // Nothing has changed.
  EXPECT_EQ(server_->sessions().open_sessions(), 1);
  EXPECT_EQ(ExportOf(**server_->sessions().Use(id)), adapter);
  EXPECT_EQ(drained_, absl::InfiniteDuration());
}

// Every method of the schema and every page stands in the table, and nothing else.
TEST(AccessOfService, IsTheSchemasAndThePagesList) {
  size_t rules = 0;
  for (const auto& [service, wire] :
       {std::pair("robostress.v1.PolicyService", AccessRule::Wire::kPolicy),
        {"robostress.v1.AdminService", AccessRule::Wire::kAdmin}}) {
    const auto* schema =
        google::protobuf::DescriptorPool::generated_pool()->FindServiceByName(service);
    for (int i = 0; i < schema->method_count(); ++i, ++rules)
      EXPECT_NE(FindRule(wire, schema->method(i)->name()), nullptr) << schema->method(i)->name();
  }
  for (const AccessRule& rule : AccessTable()) {
    const bool grpc =
        rule.wire == AccessRule::Wire::kPolicy || rule.wire == AccessRule::Wire::kAdmin;
    if (grpc) --rules;
    EXPECT_TRUE(rule.scopes != 0 || rule.wire == AccessRule::Wire::kHttp) << rule.what;
  }
  EXPECT_EQ(rules, 0u);
}

// The table, walked over every wire: with no token, a wrong one, and one of each single scope.
TEST_F(ServingSecurityTest, EveryScopeOpensWhatTheTableSaysOverEveryWireAndNothingElse) {
  std::string file = "tokens:\n";
  for (const Scope scope : kScopes)
    absl::StrAppend(&file, "  - {name: ", ScopeName(scope),
                    ", sha256: ", Sha256Hex(ScopeName(scope)), ", scopes: [", ScopeName(scope),
                    "]}\n");
  PolicyServerOptions options;
  options.tokens = std::make_shared<TokenStore>(*AccessTokens::Parse("tokens.yaml", file));
  Start(options);
  StartAdmin();
  WebEndpointsOptions web;
  web.websocket_listen = web.http_listen = "127.0.0.1:0";
  const auto endpoints = WebEndpoints::Start(web, server_.get());
  ASSERT_TRUE(endpoints.ok()) << endpoints.status();

  enum Outcome { kNoToken, kNoRight, kAllowed };
  const auto of_grpc = [](const grpc::Status& status) {
    if (status.error_code() == grpc::StatusCode::UNAUTHENTICATED) return kNoToken;
    return status.error_code() == grpc::StatusCode::PERMISSION_DENIED ? kNoRight : kAllowed;
  };
  const auto of_http = [](int status) {
    return status == 401 ? kNoToken : status == 403 ? kNoRight : kAllowed;
  };
  int walked = 0;
  for (const AccessRule& rule : AccessTable()) {
    if (rule.wire == AccessRule::Wire::kAdmin && std::string(rule.what) == "Drain") continue;
    std::vector<std::pair<std::string, Outcome>> tokens = {
        {"", rule.scopes == 0 ? kAllowed : kNoToken},
        {"guess", rule.scopes == 0 ? kAllowed : kNoToken}};
    for (const Scope scope : kScopes) {
      const bool has = rule.scopes == 0 || (rule.scopes & static_cast<uint8_t>(scope)) != 0;
      tokens.emplace_back(ScopeName(scope), has ? kAllowed : kNoRight);
    }
    for (const auto& [token, expected] : tokens) {
      const std::string value = token.empty() ? "" : absl::StrCat("Bearer ", token);
      const std::string header =
          token.empty() ? "" : absl::StrCat("Authorization: ", value, "\r\n");
      Outcome outcome = kAllowed;
      switch (rule.wire) {
        case AccessRule::Wire::kPolicy:
          outcome =
              of_grpc(Call(Plain(server_->port()),
                           absl::StrCat("/robostress.v1.PolicyService/", rule.what), "", token)
                          .status);
          break;
        case AccessRule::Wire::kAdmin:
          outcome = of_grpc(Call(Plain(admin_->port()),
                                 absl::StrCat("/robostress.v1.AdminService/", rule.what), "", token)
                                .status);
          break;
        case AccessRule::Wire::kHttp:
          outcome = of_http(WebClient((*endpoints)->http_port()).Get(rule.what, header).first);
          break;
        case AccessRule::Wire::kWebSocket:
          // What is within a conversation is asked of its caller.
          if (std::string(rule.what) == "upgrade") {
            outcome = of_http(WebClient((*endpoints)->websocket_port()).Upgrade(header));
          } else {
            const auto allowed = Allow(*options.tokens->Get(), value, rule.wire, rule.what);
            outcome = absl::IsUnauthenticated(allowed.status())    ? kNoToken
                      : absl::IsPermissionDenied(allowed.status()) ? kNoRight
                                                                   : kAllowed;
          }
          break;
      }
      EXPECT_EQ(outcome, expected) << rule.what << " with '" << token << "'";
      ++walked;
    }
  }
  EXPECT_GE(walked, 150);
  EXPECT_EQ(
      of_grpc(
          Call(Plain(admin_->port()), "/robostress.v1.AdminService/Drain", "", "metrics").status),
      kNoRight);
  EXPECT_EQ(drained_, absl::InfiniteDuration());
  EXPECT_EQ(server_->sessions().open_sessions(), 0);
}

// What a token that did not open a session can do with it: nothing, with any method.
TEST_F(ServingSecurityTest, AnotherRobotsTokenCanDoNothingWithASession) {
  PolicyServerOptions options;
  options.tokens = std::make_shared<TokenStore>(Tokens());
  Start(options);
  const std::string id = Open();  // by "arm"
  {
    Client client(std::shared_ptr<Session>(&**server_->sessions().Use(id), [](Session*) {}));
    client.StartEpisode(0, 0);
    client.RunChunks(40);
  }
  const std::string before = ExportOf(**server_->sessions().Use(id));
  int methods = 0;
  for (const AccessRule& rule : AccessTable()) {
    if (rule.wire != AccessRule::Wire::kPolicy || !rule.of_one_session) continue;
    v1::CloseSessionRequest request;  // session_id is field 1 of them all
    request.set_session_id(id);
    for (const char* token : {"other", "predict", "feedback"}) {
      const Answer answer =
          Call(Plain(server_->port()), absl::StrCat("/robostress.v1.PolicyService/", rule.what),
               request.SerializeAsString(), token);
      EXPECT_EQ(answer.status.error_code(), grpc::StatusCode::PERMISSION_DENIED)
          << rule.what << " by " << token << ": " << answer.status.error_message();
    }
    ++methods;
  }
  EXPECT_EQ(methods, 9);
  EXPECT_EQ(ExportOf(**server_->sessions().Use(id)), before);
  v1::CloseSessionRequest request;
  request.set_session_id(id);
  EXPECT_TRUE(Call(Plain(server_->port()), "/robostress.v1.PolicyService/CloseSession",
                   request.SerializeAsString(), "arm")
                  .status.ok());
}

TEST_F(ServingSecurityTest, PredictingAndTeachingAreScopesOfTheirOwn) {
  PolicyServerOptions options;
  options.tokens = std::make_shared<TokenStore>(Tokens());
  Start(options);
  const auto channel = Plain(server_->port());
  const auto code = [&](const std::string& method, const std::string& token) {
    v1::CloseSessionRequest request;
    request.set_session_id("session-9");
    return Call(channel, absl::StrCat("/robostress.v1.PolicyService/", method),
                request.SerializeAsString(), token)
        .status.error_code();
  };
  for (const char* method : {"Feedback", "ExportAdapter", "ImportAdapter", "RollbackAdapter"}) {
    EXPECT_EQ(code(method, "predict"), grpc::StatusCode::PERMISSION_DENIED) << method;
    EXPECT_EQ(code(method, "feedback"), grpc::StatusCode::NOT_FOUND) << method;
  }
  for (const char* method : {"Predict", "CloseSession", "GetStats", "StartEpisode"}) {
    EXPECT_EQ(code(method, "feedback"), grpc::StatusCode::PERMISSION_DENIED) << method;
    EXPECT_EQ(code(method, "predict"), grpc::StatusCode::NOT_FOUND) << method;
  }
}

// The server that is drained ends before Drain has returned.
TEST_F(ServingSecurityTest, DrainIsAnsweredByAServerThatStops) {
  PolicyServerOptions options;
  options.tokens = std::make_shared<TokenStore>(Tokens());
  Start(options);
  absl::Notification asked;
  AdminServerOptions admin;
  admin.drain = [&asked](absl::Duration) {
    asked.Notify();
    absl::SleepFor(absl::Milliseconds(200));
  };
  auto stopping =
      AdminServer::Start(admin, &server_->sessions(), server_->tokens(), &server_->metrics());
  ASSERT_TRUE(stopping.ok()) << stopping.status();
  std::thread stop([&] {
    asked.WaitForNotification();
    stopping->reset();
  });
  const Answer answer =
      Call(Plain((*stopping)->port()), "/robostress.v1.AdminService/Drain", "", "operator");
  stop.join();
  EXPECT_TRUE(answer.status.ok()) << answer.status.error_message();
}

TEST_F(ServingSecurityTest, OperatorsListPinRollBackExportEndAndDrain) {
  PolicyServerOptions options;
  options.tokens = std::make_shared<TokenStore>(Tokens());
  Start(options);
  StartAdmin();
  const std::string id = Open();
  {
    Client client(std::shared_ptr<Session>(&**server_->sessions().Use(id), [](Session*) {}));
    client.StartEpisode(0, 0);
    client.RunChunks(41);  // two updates
    EXPECT_EQ(client.updates(), 2u);
  }
  const auto stub = v1::AdminService::NewStub(Plain(admin_->port()));
  const auto context = [] {
    auto made = std::make_unique<grpc::ClientContext>();
    made->AddMetadata("authorization", "Bearer operator");
    return made;
  };
  v1::ListSessionsResponse sessions;
  ASSERT_TRUE(stub->ListSessions(context().get(), {}, &sessions).ok());
  ASSERT_EQ(sessions.sessions_size(), 1);
  EXPECT_EQ(sessions.sessions(0).session_id(), id);
  EXPECT_EQ(sessions.sessions(0).updates_applied(), 2u);
  EXPECT_EQ(sessions.sessions(0).feedback_sequence(), 41u);
  EXPECT_EQ(sessions.sessions(0).spec().suite(), "tabletop_goal");

  v1::ListVersionsRequest list;
  list.set_session_id(id);
  v1::ListVersionsResponse versions;
  ASSERT_TRUE(stub->ListVersions(context().get(), list, &versions).ok());
  ASSERT_EQ(versions.versions_size(), 3);
  EXPECT_TRUE(versions.versions(2).published());
  EXPECT_EQ(versions.versions(2).feedback_sequence(), 40u);
  EXPECT_EQ(versions.versions(0).distance(), 0);

  v1::PinVersionRequest pin;
  pin.set_session_id(id);
  pin.set_version(1);
  pin.set_pinned(true);
  v1::PinVersionResponse pinned;
  ASSERT_TRUE(stub->PinVersion(context().get(), pin, &pinned).ok());
  v1::ExportVersionRequest version;
  version.set_session_id(id);
  version.set_version(1);
  v1::ExportVersionResponse exported;
  ASSERT_TRUE(stub->ExportVersion(context().get(), version, &exported).ok());
  EXPECT_GT(exported.safetensors().size(), 100u);
  v1::RollbackSessionRequest rollback;
  rollback.set_session_id(id);
  rollback.set_version(1);
  v1::RollbackSessionResponse back;
  ASSERT_TRUE(stub->RollbackSession(context().get(), rollback, &back).ok());
  EXPECT_EQ(back.updates_applied(), 1u);
  rollback.set_version(77);
  EXPECT_FALSE(stub->RollbackSession(context().get(), rollback, &back).ok());

  v1::EndSessionRequest end;
  end.set_session_id(id);
  v1::EndSessionResponse ended;
  ASSERT_TRUE(stub->EndSession(context().get(), end, &ended).ok());
  EXPECT_EQ(stub->EndSession(context().get(), end, &ended).error_code(),
            grpc::StatusCode::NOT_FOUND);

  v1::DrainRequest drain;
  drain.set_grace_s(3);
  v1::DrainResponse draining;
  ASSERT_TRUE(stub->Drain(context().get(), drain, &draining).ok());
  EXPECT_EQ(drained_, absl::Seconds(3));
  EXPECT_FALSE(server_->ready());
  EXPECT_EQ(
      Call(Plain(server_->port()), "/robostress.v1.PolicyService/OpenSession", OpenRequest(), "arm")
          .status.error_code(),
      grpc::StatusCode::UNAVAILABLE);
}

// A policy that takes its time to warm up.
class SlowToWarm : public FakePolicy {
 public:
  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    if (!warmed_.HasBeenNotified()) {
      begun_.Notify();
      warmed_.WaitForNotification();
    }
    return FakePolicy::Encode(observation);
  }
  mutable absl::Notification begun_, warmed_;
};

TEST(Health, SaysServingOnlyAfterWarmUpAndUntilTheDrain) {
  const auto policy = std::make_shared<SlowToWarm>();
  PolicyServerOptions options;
  {  // a port that is free now
    auto other = PolicyServer::Start({}, {std::make_shared<FakePolicy>()});
    options.listen = absl::StrCat("127.0.0.1:", (*other)->port());
  }
  std::unique_ptr<PolicyServer> server;
  std::thread starting([&] {
    auto started = PolicyServer::Start(options, {policy});
    ASSERT_TRUE(started.ok()) << started.status();
    server = *std::move(started);
  });
  policy->begun_.WaitForNotification();
  const auto channel = grpc::CreateChannel(options.listen, grpc::InsecureChannelCredentials());
  ASSERT_TRUE(
      channel->WaitForConnected(std::chrono::system_clock::now() + std::chrono::seconds(20)));
  const auto health = [&](const std::string& service) {
    std::string request;  // field 1: the service's name
    if (!service.empty())
      request = absl::StrCat("\x0a", std::string(1, static_cast<char>(service.size())), service);
    return Call(channel, "/grpc.health.v1.Health/Check", request).bytes;
  };
  const std::string not_serving("\x08\x02", 2), serving("\x08\x01", 2);
  EXPECT_EQ(health(""), not_serving);
  EXPECT_EQ(health("robostress.v1.PolicyService"), not_serving);
  policy->warmed_.Notify();
  starting.join();
  EXPECT_TRUE(server->ready());
  EXPECT_EQ(health(""), serving);
  EXPECT_EQ(health("robostress.v1.PolicyService"), serving);
  server->Drain();
  EXPECT_EQ(health(""), not_serving);
}

TEST(Reflection, NamesTheServices) {
  auto server = PolicyServer::Start({}, {std::make_shared<FakePolicy>()});
  ASSERT_TRUE(server.ok());
  // ServerReflectionRequest{list_services: "*"}; the answer holds the names as they are.
  const Answer answer = Call(Plain((*server)->port()),
                             "/grpc.reflection.v1alpha.ServerReflection/ServerReflectionInfo",
                             std::string("\x3a\x01*", 3));
  EXPECT_THAT(answer.bytes, HasSubstr("robostress.v1.PolicyService"));
  EXPECT_THAT(answer.bytes, HasSubstr("grpc.health.v1.Health"));
}

class TlsTest : public ServingSecurityTest {
 protected:
  // An authority, and certificates of a server (127.0.0.1), a client, and a client of another
  // authority.
  static void SetUpTestSuite() {
    certificates_ = new TestCertificates();
    for (const char* authority : {"ca", "other"}) certificates_->MakeAuthority(authority);
    for (const char* name : {"server", "client"}) certificates_->Make(name, "ca");
    certificates_->Make("stranger", "other");
  }
  static void TearDownTestSuite() { delete certificates_; }
  static std::string File(const std::string& name) { return certificates_->File(name); }
  static std::string Read(const std::string& name) { return certificates_->Read(name); }
  static std::shared_ptr<TlsStore> Tls(const std::string& authority = "") {
    return *LoadTls(certificates_->Files("server", authority));
  }
  grpc::StatusCode Info(const std::string& client) const {
    grpc::SslCredentialsOptions options;
    options.pem_root_certs = Read("ca.crt");
    if (!client.empty()) {
      options.pem_private_key = Read(client + ".key");
      options.pem_cert_chain = Read(client + ".crt");
    }
    return Call(grpc::CreateChannel(absl::StrCat("127.0.0.1:", server_->port()),
                                    grpc::SslCredentials(options)),
                "/robostress.v1.PolicyService/GetServerInfo", "")
        .status.error_code();
  }

  static inline TestCertificates* certificates_ = nullptr;
};

TEST_F(TlsTest, EncryptsAndRefusesPlainText) {
  PolicyServerOptions options;
  options.tls = Tls();
  Start(options);
  EXPECT_EQ(Info(""), grpc::StatusCode::OK);
  EXPECT_EQ(Call(Plain(server_->port()), "/robostress.v1.PolicyService/GetServerInfo", "")
                .status.error_code(),
            grpc::StatusCode::UNAVAILABLE);
}

TEST_F(TlsTest, AsksForACertificateOfItsAuthority) {
  PolicyServerOptions options;
  options.tls = Tls("ca");
  Start(options);
  EXPECT_EQ(Info("client"), grpc::StatusCode::OK);
  EXPECT_EQ(Info(""), grpc::StatusCode::UNAVAILABLE);
  EXPECT_EQ(Info("stranger"), grpc::StatusCode::UNAVAILABLE);
}

TEST_F(TlsTest, OurOwnClientTakesCertificateAndTokenFromTheEnvironment) {
  PolicyServerOptions options;
  options.tls = Tls("ca");
  options.tokens = std::make_shared<TokenStore>(Tokens());
  Start(options);
  ASSERT_TRUE(WriteFileAtomically(File("token"), "arm\n").ok());
  PolicyClientOptions address;
  address.address = absl::StrCat("127.0.0.1:", server_->port());
  address.connect_timeout_s = 5;
  const std::pair<const char*, const char*> variables[] = {
      {"ROBOSTRESS_TLS_CA", "ca.crt"},
      {"ROBOSTRESS_TLS_CERTIFICATE", "client.crt"},
      {"ROBOSTRESS_TLS_KEY", "client.key"},
      {"ROBOSTRESS_TOKEN_FILE", "token"}};
  for (const auto& [variable, file] : variables) setenv(variable, File(file).c_str(), 1);
  auto client = GrpcPolicyClient::Connect(address, RequestOf(Spec("base")));
  EXPECT_TRUE(client.ok()) << client.status();
  if (client.ok()) {
    EXPECT_TRUE((*client)->StartEpisode({0, 0}).ok());
    EXPECT_TRUE((*client)->Predict(FakePolicy::MakeObservation(0), 0).ok());
  }
  unsetenv("ROBOSTRESS_TOKEN_FILE");
  EXPECT_EQ(GrpcPolicyClient::Connect(address, RequestOf(Spec("base"))).status().code(),
            absl::StatusCode::kUnauthenticated);
  setenv("ROBOSTRESS_TOKEN_FILE", File("token").c_str(), 1);
  unsetenv("ROBOSTRESS_TLS_CA");
  EXPECT_THAT(
      std::string(GrpcPolicyClient::Connect(address, RequestOf(Spec("base"))).status().message()),
      HasSubstr("need ROBOSTRESS_TLS_CA"));
  for (const auto& [variable, file] : variables) unsetenv(variable);
}

TEST_F(TlsTest, CoversTheWebPorts) {
  PolicyServerOptions options;
  options.tls = Tls();
  Start(options);
  WebEndpointsOptions web;
  web.websocket_listen = web.http_listen = "127.0.0.1:0";
  web.tls = options.tls;
  auto endpoints = WebEndpoints::Start(web, server_.get());
  ASSERT_TRUE(endpoints.ok()) << endpoints.status();
  for (const int port : {(*endpoints)->http_port(), (*endpoints)->websocket_port()}) {
    TlsWebClient encrypted(port, File("ca.crt"));
    EXPECT_TRUE(encrypted.connected());
    EXPECT_EQ(encrypted.Get("/healthz").first, 200);
    EXPECT_EQ(WebClient(port).Get("/healthz").first, 0);
    EXPECT_FALSE(TlsWebClient(port, File("other.crt")).connected());
  }
  OpenpiConnectionOptions trusting;
  trusting.socket.secrets.authority = *ReadFile(File("ca.crt"));
  const std::string websocket = absl::StrCat("wss://127.0.0.1:", (*endpoints)->websocket_port());
  const auto client = OpenpiConnection::Connect(websocket, trusting);
  EXPECT_TRUE(client.ok()) << client.status();

  web.tls = Tls("ca");
  endpoints->reset();
  endpoints = WebEndpoints::Start(web, server_.get());
  ASSERT_TRUE(endpoints.ok()) << endpoints.status();
  for (const int port : {(*endpoints)->http_port(), (*endpoints)->websocket_port()}) {
    const auto health = [&](const std::string& name) {
      return TlsWebClient(port, File("ca.crt"), File(name + ".crt"), File(name + ".key"))
          .Get("/healthz")
          .first;
    };
    EXPECT_EQ(health("client"), 200);
    EXPECT_EQ(health("stranger"), 0);
    EXPECT_EQ(TlsWebClient(port, File("ca.crt")).Get("/healthz").first, 0);
  }
}

TEST_F(TlsTest, NamesTheFileThatIsWrong) {
  const auto refusal = [](const TlsFiles& files) {
    const auto contents = ReadTlsFiles(files);
    EXPECT_FALSE(contents.ok());
    return std::string(contents.status().message());
  };
  EXPECT_THAT(refusal({File("server.crt"), "", ""}), HasSubstr("--tls-key"));
  EXPECT_THAT(refusal({File("server.crt"), File("client.key"), ""}),
              HasSubstr("client.key: is not the key of the certificate"));
  EXPECT_THAT(refusal({File("san"), File("server.key"), ""}),
              HasSubstr("san: holds no certificate"));
  EXPECT_THAT(refusal({File("server.crt"), File("server.crt"), ""}), HasSubstr("server.crt: "));
  chmod(File("stranger.key").c_str(), 0644);
  EXPECT_THAT(refusal({File("stranger.crt"), File("stranger.key"), ""}),
              HasSubstr("everybody may open this key (mode 644); chmod 600 it"));
  chmod(File("stranger.key").c_str(), 0600);
}

// Every port at once: new connections show the new certificate and ask the new authority.
TEST_F(TlsTest, TakesNewCertificatesAndAuthoritiesWithoutARestart) {
  PolicyServerOptions options;
  options.tls = Tls("ca");
  Start(options);
  AdminServerOptions operators;
  operators.tls = options.tls;
  auto admin =
      AdminServer::Start(operators, &server_->sessions(), server_->tokens(), &server_->metrics());
  ASSERT_TRUE(admin.ok()) << admin.status();
  WebEndpointsOptions web;
  web.websocket_listen = web.http_listen = "127.0.0.1:0";
  web.tls = options.tls;
  auto endpoints = WebEndpoints::Start(web, server_.get());
  ASSERT_TRUE(endpoints.ok()) << endpoints.status();
  // Whether a client who trusts `authority` and shows `name` is served, on each port.
  const auto served = [&](const std::string& authority, const std::string& name) {
    std::vector<bool> answers;
    grpc::SslCredentialsOptions ssl;
    ssl.pem_root_certs = Read(authority + ".crt");
    ssl.pem_private_key = Read(name + ".key");
    ssl.pem_cert_chain = Read(name + ".crt");
    grpc::ChannelArguments own;  // no connection of an earlier call
    own.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);
    for (const auto& [port, method] :
         {std::pair(server_->port(), "/robostress.v1.PolicyService/GetServerInfo"),
          {(*admin)->port(), "/robostress.v1.AdminService/ListSessions"}}) {
      const auto channel = grpc::CreateCustomChannel(absl::StrCat("127.0.0.1:", port),
                                                     grpc::SslCredentials(ssl), own);
      answers.push_back(Call(channel, method, "").status.ok());
    }
    for (const int port : {(*endpoints)->http_port(), (*endpoints)->websocket_port()}) {
      TlsWebClient client(port, File(authority + ".crt"), File(name + ".crt"), File(name + ".key"));
      answers.push_back(client.connected() && client.Get("/healthz").first == 200);
    }
    return answers;
  };
  const std::vector<bool> all(4, true), none(4, false);
  EXPECT_EQ(served("ca", "client"), all);
  EXPECT_EQ(served("ca", "stranger"), none);

  TlsFiles next = certificates_->Files("stranger", "other");  // for 127.0.0.1, by the other one
  auto snapshot = ReadTlsFiles(next);
  ASSERT_TRUE(snapshot.ok()) << snapshot.status();
  options.tls->Set(*std::move(snapshot));
  EXPECT_EQ(served("other", "stranger"), all);
  EXPECT_EQ(served("ca", "client"), none);
  EXPECT_EQ(served("other", "client"), none);
}

// A service that says who calls.
std::string OwnerSeenByGrpc(const std::shared_ptr<TlsStore>& tls,
                            const grpc::SslCredentialsOptions& client) {
  const auto credentials = MakeServerCredentials(tls);
  grpc::AsyncGenericService service;
  grpc::ServerBuilder builder;
  int port = 0;
  builder.AddListeningPort("127.0.0.1:0", credentials, &port);
  builder.RegisterAsyncGenericService(&service);
  const auto queue = builder.AddCompletionQueue();
  const auto server = builder.BuildAndStart();
  grpc::GenericServerContext context;
  grpc::GenericServerAsyncReaderWriter call(&context);
  service.RequestCall(&context, &call, queue.get(), queue.get(), nullptr);
  std::string owner;
  std::thread serving([&] {
    void* tag = nullptr;
    bool ok = false;
    if (!queue->Next(&tag, &ok) || !ok) return;
    owner = PeerCertificateOwner(*context.auth_context());
    call.Finish(grpc::Status::OK, nullptr);
    queue->Next(&tag, &ok);
  });
  Call(grpc::CreateChannel(absl::StrCat("127.0.0.1:", port), grpc::SslCredentials(client)), "/a/b",
       "");
  server->Shutdown();
  queue->Shutdown();
  serving.join();
  return owner;
}

TEST_F(TlsTest, ACertificateNamesTheSameOwnerOnBothWires) {
  Metrics metrics;
  const std::shared_ptr<TlsStore> asking = Tls("ca"), plain = Tls();
  std::map<std::string, std::string> web_owners;
  for (const auto& [tls, name] : {std::pair(asking, "client"), {asking, "server"}, {plain, ""}}) {
    WebServerOptions options;
    options.tls = tls;
    auto web = WebServer::Start(
        options,
        [](const WebRequest& request) {
          return WebReply{200, "text/plain", request.certificate_owner};
        },
        nullptr, &metrics);
    ASSERT_TRUE(web.ok());
    const std::string shown = name;
    const std::string file = shown.empty() ? "" : File(shown + ".crt");
    TlsWebClient client((*web)->port(), File("ca.crt"), file,
                        shown.empty() ? "" : File(shown + ".key"));
    const auto [status, owner] = client.Get("/");
    EXPECT_EQ(status, 200);

    grpc::SslCredentialsOptions ssl;
    ssl.pem_root_certs = Read("ca.crt");
    if (!shown.empty()) {
      ssl.pem_private_key = Read(shown + ".key");
      ssl.pem_cert_chain = Read(shown + ".crt");
    }
    EXPECT_EQ(OwnerSeenByGrpc(tls, ssl), owner) << shown;
    if (!shown.empty()) {
      const auto [digest, code] =
          RunProgram("openssl", "x509 -in " + file + " -outform DER | sha256sum");
      EXPECT_EQ(owner, "certificate:" + digest.substr(0, 64));
    }
    web_owners[shown] = owner;
  }
  EXPECT_EQ(web_owners[""], "");
  EXPECT_NE(web_owners["client"], web_owners["server"]);
}

TEST_F(ServingSecurityTest,
       ARevokedTokenIsRefusedOnTheNextCallAndEndsItsWebSocketAtTheNextMessage) {
  PolicyServerOptions options;
  options.tokens = std::make_shared<TokenStore>(Tokens());
  Start(options);
  StartAdmin();
  WebEndpointsOptions web;
  web.websocket_listen = web.http_listen = "127.0.0.1:0";
  auto endpoints = WebEndpoints::Start(web, server_.get());
  ASSERT_TRUE(endpoints.ok()) << endpoints.status();
  const auto code = [&](int port, const char* method, const char* token) {
    return Call(Plain(port), method, "", token).status.error_code();
  };
  const auto info = [&] {
    return code(server_->port(), "/robostress.v1.PolicyService/GetServerInfo", "arm");
  };
  const auto list = [&] {
    return code(admin_->port(), "/robostress.v1.AdminService/ListSessions", "operator");
  };
  const auto page = [&] {
    return WebClient((*endpoints)->http_port())
        .Get("/metrics", "Authorization: Bearer prometheus\r\n")
        .first;
  };
  const auto connect = [&](const std::string& token) {
    OpenpiConnectionOptions showing;
    showing.socket.secrets.token = token;
    showing.socket.token_scheme = "Bearer";
    return OpenpiConnection::Connect(
        absl::StrCat("ws://127.0.0.1:", (*endpoints)->websocket_port()), showing);
  };
  const auto talk = [&](OpenpiConnection& client) {  // what comes back for a message
    return std::string(client.Ask("\x80", absl::Seconds(30))
                           .status()
                           .message());  // an empty map: an error of its own
  };
  const auto arm = connect("arm"), feeder = connect("predict");
  ASSERT_TRUE(arm.ok()) << arm.status();
  ASSERT_TRUE(feeder.ok()) << feeder.status();
  EXPECT_EQ(info(), grpc::StatusCode::OK);
  EXPECT_EQ(list(), grpc::StatusCode::OK);
  EXPECT_EQ(page(), 200);

  // `arm` is revoked, `predict` stays as it was.
  options.tokens->Set(*AccessTokens::Parse(
      "tokens.yaml", absl::StrCat("tokens: [{name: predict, sha256: ", Sha256Hex("predict"),
                                  ", scopes: [predict]}]")));
  EXPECT_EQ(info(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(list(), grpc::StatusCode::UNAUTHENTICATED);
  EXPECT_EQ(page(), 401);
  EXPECT_THAT(talk(**arm), HasSubstr("no valid token"));
  EXPECT_THAT(talk(**feeder), Not(HasSubstr("token")));
}

// A client that ends in the middle of a stream, at every place where it can.
TEST_F(ServingSecurityTest, StreamsCutAtEveryMessageLeaveTheSessionAsItWas) {
  Start({});
  const auto stub = v1::PolicyService::NewStub(Plain(server_->port()));
  v1::OpenSessionRequest open;
  *open.mutable_spec() = ToProto(RequestOf(Spec("ours")));
  v1::OpenSessionResponse session;
  {
    grpc::ClientContext context;
    ASSERT_TRUE(stub->OpenSession(&context, open, &session).ok());
  }
  v1::StartEpisodeRequest start;
  start.set_session_id(session.session_id());
  v1::StartEpisodeResponse started;
  {
    grpc::ClientContext context;
    ASSERT_TRUE(stub->StartEpisode(&context, start, &started).ok());
  }
  ToyArm arm(0.6);
  uint64_t sequence = 0;
  for (int cut = 0; cut < 24; ++cut) {
    // 0: after the call, 1: after a request, 2: after its answer, 3: after half-closing.
    const int place = cut % 4;
    v1::PredictRequest request;
    request.set_session_id(session.session_id());
    request.set_chunk(static_cast<uint32_t>(cut));
    request.set_last_feedback_sequence(sequence);
    *request.mutable_observation() = ToProto(FakePolicy::MakeObservation(cut));
    v1::PredictResponse response;
    {
      grpc::ClientContext context;
      auto stream = stub->Predict(&context);
      if (place >= 1) {
        ASSERT_TRUE(stream->Write(request));
      }
      if (place >= 2) {
        ASSERT_TRUE(stream->Read(&response));
      }
      if (place >= 3) stream->WritesDone();
      context.TryCancel();
      stream->Finish().IgnoreError();
    }
    if (place < 2) continue;
    ExecutedChunk executed = arm.Execute(*FromProto(response), 5);
    executed.sequence = sequence + 1;
    executed.chunk = cut;
    v1::FeedbackRequest feedback;
    feedback.set_session_id(session.session_id());
    *feedback.mutable_chunk() = ToProto(executed);
    // Sent, and cut before the acknowledgement; then again on a new stream, until it is known.
    {
      grpc::ClientContext context;
      auto stream = stub->Feedback(&context);
      ASSERT_TRUE(stream->Write(feedback));
      context.TryCancel();
      stream->Finish().IgnoreError();
    }
    grpc::ClientContext context;
    auto stream = stub->Feedback(&context);
    ASSERT_TRUE(stream->Write(feedback));
    v1::FeedbackAck ack;
    ASSERT_TRUE(stream->Read(&ack));
    EXPECT_EQ(ack.sequence(), ++sequence);
    stream->WritesDone();
    EXPECT_TRUE(stream->Finish().ok());
  }
  EXPECT_EQ(server_->sessions().List()[0].feedback_sequence, sequence);
  EXPECT_TRUE(server_->sessions().AwaitIdle(absl::Seconds(20)));
}

TEST_F(ServingSecurityTest, MalformedObservationsAndNaNChangeNothing) {
  Start({});
  const std::string id = [&] {
    v1::OpenSessionResponse response;
    response.ParseFromString(
        Call(Plain(server_->port()), "/robostress.v1.PolicyService/OpenSession", OpenRequest())
            .bytes);
    return response.session_id();
  }();
  ASSERT_TRUE((*server_->host().Use(Anybody(), id))->StartEpisode({0, 0}, 0).ok());
  const auto predict = [&](const Observation& observation) {
    v1::PredictRequest request;
    request.set_session_id(id);
    *request.mutable_observation() = ToProto(observation);
    const Answer answer = Call(Plain(server_->port()), "/robostress.v1.PolicyService/Predict",
                               request.SerializeAsString());
    return answer.status.error_code();
  };
  Observation observation = FakePolicy::MakeObservation(0);
  observation.proprioception[1] = std::nanf("");
  EXPECT_EQ(predict(observation), grpc::StatusCode::INVALID_ARGUMENT);
  observation = FakePolicy::MakeObservation(0);
  observation.proprioception.conservativeResize(2);
  EXPECT_EQ(predict(observation), grpc::StatusCode::INVALID_ARGUMENT);
  observation = FakePolicy::MakeObservation(0);
  observation.views.push_back({"unasked", Image{1, 1, {1, 2, 3}}});
  EXPECT_EQ(predict(observation), grpc::StatusCode::INVALID_ARGUMENT);
  Call(Plain(server_->port()), "/robostress.v1.PolicyService/Predict", "\xff\xff");  // no message
  EXPECT_EQ(server_->sessions().List()[0].counters.predictions, 0u);
  EXPECT_EQ(predict(FakePolicy::MakeObservation(0)), grpc::StatusCode::OK);
}

TEST_F(ServingSecurityTest, AThousandSessionsOpenedAndDroppedLeaveNothingBehind) {
  PolicyServerOptions options;
  options.abandoned_after = absl::ZeroDuration();
  options.max_sessions = 8;
  Start(options);
  const auto channel = Plain(server_->port());
  for (int i = 0; i < 1000; ++i) {  // never closed: the client is gone
    ASSERT_TRUE(
        Call(channel, "/robostress.v1.PolicyService/OpenSession", OpenRequest()).status.ok());
  }
  EXPECT_LE(server_->sessions().open_sessions(), 8);
  server_->telemetry().Refresh(server_->host().Figures());
  EXPECT_LE(server_->telemetry().Views().size(), 8u);
  EXPECT_LT(server_->metrics().size(), 200u);
}

}  // namespace
}  // namespace robostress
