// Keys of policy servers, from the sweep's command line to its report, with the real worker: over
// ws and over wss, the right key, a wrong one, none, and files that hold no key.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/ssl/context.hpp>
#include <boost/asio/ssl/stream.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http/read.hpp>
#include <boost/beast/http/string_body.hpp>
#include <boost/beast/http/write.hpp>
#include <boost/beast/websocket/ssl.hpp>
#include <boost/beast/websocket/stream.hpp>
#include <filesystem>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/wire/openpi_writer.h"
#include "tests/run_program.h"
#include "tests/server/operations/test_certificates.h"

namespace robostress {
namespace {

namespace net = boost::asio;
namespace http = boost::beast::http;
using ::testing::AllOf;
using ::testing::Each;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr char kKey[] = "tk-5f2c";
constexpr char kTokenFile[] = "ROBOSTRESS_TOKEN_FILE";

// A policy server of openpi's wire that opens no WebSocket without its key. It is Asio's own TLS,
// and none of our code.
class LockedPolicy {
 public:
  using Tcp = net::ip::tcp;
  using Error = boost::system::error_code;

  // `certificates` null: plain; else it shows "server".
  explicit LockedPolicy(const TestCertificates* certificates = nullptr)
      : LockedPolicy(kKey, certificates) {}
  explicit LockedPolicy(std::string key, const TestCertificates* certificates = nullptr)
      : tls_(certificates != nullptr), key_(std::move(key)) {
    if (tls_) {
      context_.use_certificate_chain_file(certificates->File("server.crt"));
      context_.use_private_key_file(certificates->File("server.key"), net::ssl::context::pem);
    }
    thread_ = std::thread([this] { Accept(); });
  }
  ~LockedPolicy() {
    ended_ = true;
    Error ignored;
    Tcp::socket(io_).connect(acceptor_.local_endpoint(), ignored);
    thread_.join();
  }
  std::string url() const {
    return absl::StrCat(tls_ ? "wss" : "ws", "://127.0.0.1:", acceptor_.local_endpoint().port());
  }
  // Authorization of every handshake, in order; nothing that TLS refused is among them.
  std::vector<std::string> shown() const {
    const std::lock_guard lock(mutex_);
    return shown_;
  }

 private:
  void Accept() {
    while (!ended_) {
      Error error;
      Tcp::socket socket(io_);
      acceptor_.accept(socket, error);
      if (error || ended_) return;
      if (!tls_) {
        Talk(socket);
        continue;
      }
      net::ssl::stream<Tcp::socket> stream(std::move(socket), context_);
      stream.handshake(net::ssl::stream_base::server, error);
      if (!error) Talk(stream);
    }
  }
  template <class Stream>
  void Talk(Stream& stream) {
    Error error;
    boost::beast::flat_buffer buffer;
    http::request<http::string_body> request;
    http::read(stream, buffer, request, error);
    if (error) return;
    const auto key = request[http::field::authorization];
    {
      const std::lock_guard lock(mutex_);
      shown_.emplace_back(key.data(), key.size());
    }
    if (shown_.back() != absl::StrCat("Api-Key ", key_)) {
      http::response<http::string_body> refusal(http::status::unauthorized, 11);
      refusal.body() = "no such key\n";
      refusal.prepare_payload();
      http::write(stream, refusal, error);
      return;
    }
    boost::beast::websocket::stream<Stream&> web(stream);
    web.accept(request, error);
    web.binary(true);
    web.write(net::buffer(OpenpiWriter().Map(0).Take()), error);
    const std::string chunk =
        OpenpiWriter().Map(1).Text("actions").Array(Eigen::MatrixXf::Zero(50, 7)).Take();
    while (!error) {
      boost::beast::flat_buffer question;
      web.read(question, error);
      if (!error) web.write(net::buffer(chunk), error);
    }
  }

  const bool tls_;
  const std::string key_;
  net::io_context io_;
  net::ssl::context context_{net::ssl::context::tls_server};
  Tcp::acceptor acceptor_{io_, Tcp::endpoint(net::ip::make_address("127.0.0.1"), 0)};
  std::atomic<bool> ended_ = false;
  mutable std::mutex mutex_;
  std::vector<std::string> shown_;
  std::thread thread_;
};

class PolicyKeys : public ::testing::Test {
 protected:
  PolicyKeys()
      : folder_(absl::StrCat(::testing::TempDir(), "policy_keys_", getpid(), "_",
                             ::testing::UnitTest::GetInstance()->current_test_info()->name())) {
    std::filesystem::create_directories(folder_);
    certificates_.MakeAuthority("ca");
    certificates_.Make("server", "ca");
  }
  ~PolicyKeys() override { std::filesystem::remove_all(folder_); }

  std::string Path(const std::string& name) const { return absl::StrCat(folder_, "/", name); }
  // VARIABLE=FILE of a key's file with that mode.
  std::string Key(const std::string& contents, mode_t mode = 0600) const {
    const std::string file = Path("key");
    EXPECT_TRUE(WriteFileAtomically(file, contents).ok());
    EXPECT_EQ(chmod(file.c_str(), mode), 0);
    return absl::StrCat(kTokenFile, "=", file, " ");
  }
  std::string Authority(const std::string& name = "ca") const {
    return absl::StrCat("ROBOSTRESS_TLS_CA=", certificates_.File(name + ".crt"), " ");
  }
  // One task, one episode.
  std::pair<std::string, int> Sweep(const std::string& url, const std::string& environment) const {
    std::filesystem::remove_all(Path("run"));
    return RunProgram("env " + environment,
                      absl::StrCat(BIN_DIR,
                                   "/robostress-sweep --suites tabletop_goal --tasks 3-3 "
                                   "--episodes 1 --scenarios clean --workers 1 --quiet --policies "
                                   "theirs --methods base --policy-url ",
                                   url, " --out ", Path("run")));
  }
  // It is swept to its report.
  void ExpectSwept(const LockedPolicy& server, const std::string& environment) const {
    const auto [output, code] = Sweep(server.url(), environment);
    EXPECT_EQ(code, 0) << output;
    EXPECT_THAT(output, Not(HasSubstr(kKey)));
    EXPECT_TRUE(std::filesystem::exists(Path("run/report.html")));
    EXPECT_THAT(server.shown(), Each(absl::StrCat("Api-Key ", kKey)));
    EXPECT_GE(server.shown().size(), 2u) << "the sweep that looks, and the worker";
    // Nowhere does it stand in what was written.
    EXPECT_EQ(RunProgram("grep", absl::StrCat("-r ", kKey, " ", Path("run"))).first, "");
  }
  // It says all of `words` before any unit starts.
  void ExpectRefused(const std::string& url, const std::string& environment,
                     const std::vector<std::string>& words) const {
    const auto [output, code] = Sweep(url, environment);
    EXPECT_NE(code, 0) << output;
    for (const std::string& word : words) EXPECT_THAT(output, HasSubstr(word));
    EXPECT_THAT(output, Not(HasSubstr(kKey)));
    const std::string units = Path("run/units");
    EXPECT_TRUE(!std::filesystem::exists(units) || std::filesystem::is_empty(units)) << output;
  }

  const TestCertificates certificates_;
  const std::string folder_;
};

TEST_F(PolicyKeys, TheRightKeyOpensAServer) {
  const LockedPolicy server;
  ExpectSwept(server, Key(kKey));
  ExpectSwept(server, Key(absl::StrCat(kKey, "\r\n"), 0640));  // as editors and clusters write it
}

TEST_F(PolicyKeys, TheRightKeyOpensAServerUnderTls) {
  const LockedPolicy server(&certificates_);
  ExpectSwept(server, Authority() + Key(absl::StrCat(kKey, "\n")));
}

TEST_F(PolicyKeys, AWrongKeyAndNoneAreSaidBeforeAnyUnitStarts) {
  const LockedPolicy plain, tls(&certificates_);
  for (const LockedPolicy* server : {&plain, &tls}) {
    const std::string trust = Authority();
    ExpectRefused(server->url(), trust,
                  {server->url(), "answers HTTP 401", "no such key",
                   "name the file of its token in ROBOSTRESS_TOKEN_FILE"});
    ExpectRefused(server->url(), trust + Key("another"),
                  {server->url(), "it does not know the token that ROBOSTRESS_TOKEN_FILE names"});
    EXPECT_EQ(server->shown(), (std::vector<std::string>{"", "Api-Key another"}));
  }
}

TEST_F(PolicyKeys, AServerThatNobodyVouchesForSeesNoKey) {
  const LockedPolicy server(&certificates_);
  ExpectRefused(server.url(), Key(kKey), {server.url(), "TLS", "ROBOSTRESS_TLS_CA"});
  certificates_.MakeAuthority("another");
  ExpectRefused(server.url(), Authority("another") + Key(kKey),
                {server.url(), "TLS", "ROBOSTRESS_TLS_CA"});
  certificates_.Write("garbage.crt", "garbage");
  ExpectRefused(server.url(), Authority("garbage") + Key(kKey), {"holds no certificate"});
  EXPECT_TRUE(server.shown().empty());
}

TEST_F(PolicyKeys, AFileThatHoldsNoKeyIsNamed) {
  const LockedPolicy server;
  const std::string file = absl::StrCat(kTokenFile, "=", Path("key"));
  ExpectRefused(server.url(), Key(""), {file, "is empty"});
  ExpectRefused(server.url(), Key("\n"), {file, "is empty", "on one line"});
  ExpectRefused(server.url(), Key("two\nlines\n"), {file, "more than one word", "on one line"});
  ExpectRefused(server.url(), Key("k\xc3\xa9y"), {file, "what is not ASCII"});
  ExpectRefused(server.url(), absl::StrCat(kTokenFile, "=", Path("absent"), " "),
                {Path("absent"), "No such file"});
  ExpectRefused(server.url(), absl::StrCat(kTokenFile, "=", folder_, " "), {folder_});
  EXPECT_TRUE(server.shown().empty());
}

// Of several servers each is dialled, not only the first that opens.
TEST_F(PolicyKeys, OneOfSeveralServersThatRefusesTheKeyIsSaidBeforeAnyUnitStarts) {
  const LockedPolicy server, of_another_key("another");
  const std::string both = absl::StrCat(server.url(), " --policy-url ", of_another_key.url());
  ExpectRefused(both, Key(kKey), {of_another_key.url(), "it does not know the token"});
  std::string nobody;
  {
    const LockedPolicy gone;
    nobody = gone.url();
  }
  const auto [output, code] =
      Sweep(absl::StrCat(nobody, " --policy-url ", server.url()), Key(kKey));
  EXPECT_EQ(code, 0) << output;
  EXPECT_THAT(output, AllOf(HasSubstr(nobody), HasSubstr("Connection refused"),
                            HasSubstr("units go to the other servers meanwhile")));
}

TEST_F(PolicyKeys, AKeyThatEverybodyMayReadIsWarnedOf) {
  const LockedPolicy server;
  const std::string warning = "everybody on this machine may open it (mode 644); chmod 600 it";
  const auto [open, code] = Sweep(server.url(), Key(kKey, 0644));
  EXPECT_EQ(code, 0) << open;
  EXPECT_THAT(open, AllOf(HasSubstr(Path("key")), HasSubstr(warning), Not(HasSubstr(kKey))));
  EXPECT_THAT(Sweep(server.url(), Key(kKey, 0640)).first, Not(HasSubstr("chmod")));
}

TEST_F(PolicyKeys, AKeyThatIsNotReadableIsNamed) {
  if (geteuid() == 0) GTEST_SKIP() << "root reads every file";
  const LockedPolicy server;
  ExpectRefused(server.url(), Key(kKey, 0000), {Path("key"), "Permission denied"});
}

}  // namespace
}  // namespace robostress
