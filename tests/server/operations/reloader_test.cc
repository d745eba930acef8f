#include "server/operations/reloader.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/match.h"
#include "absl/time/clock.h"
#include "tests/server/operations/test_certificates.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class ReloaderTest : public ::testing::Test {
 protected:
  static void SetUpTestSuite() {
    certificates_ = new TestCertificates();
    certificates_->MakeAuthority("ca");
    certificates_->MakeAuthority("other");
    for (const char* name : {"old", "new"}) certificates_->Make(name, "ca");
  }
  static void TearDownTestSuite() { delete certificates_; }

  void SetUp() override {
    Put("old");
    WriteTokens("arm", "predict");
    Start();
  }
  void Start(absl::Duration period = absl::ZeroDuration()) {
    ReloaderOptions options;
    options.tls_files = certificates_->Files("served", "served_ca");
    options.tokens_file = certificates_->File("tokens.yaml");
    options.period = period;
    auto tls = LoadTls(options.tls_files);
    ASSERT_TRUE(tls.ok()) << tls.status();
    tls_ = *tls;
    tokens_ = std::make_shared<TokenStore>(*AccessTokens::Load(options.tokens_file));
    auto reloader = Reloader::Start(options, tls_, tokens_, &metrics_);
    ASSERT_TRUE(reloader.ok()) << reloader.status();
    reloader_ = *std::move(reloader);
  }
  // What is served becomes this certificate.
  static void Put(const std::string& name) {
    certificates_->Write("served.crt", certificates_->Read(name + ".crt"));
    certificates_->Write("served.key", certificates_->Read(name + ".key"));
    certificates_->Write("served_ca.crt", certificates_->Read("ca.crt"));
  }
  static void WriteTokens(const std::string& name, const std::string& scopes) {
    certificates_->Write("tokens.yaml",
                         absl::StrCat("tokens: [{name: ", name, ", sha256: ", Sha256Hex(name),
                                      ", scopes: [", scopes, "]}]\n"));
  }
  double Count(const char* name, const char* what) {
    return metrics_.AddCounter(name, "", {{"what", what}})->Value();
  }
  // Until `done`, or 10 s.
  static bool Await(const std::function<bool()>& done) {
    for (int i = 0; i < 1000 && !done(); ++i) absl::SleepFor(absl::Milliseconds(10));
    return done();
  }
  // Asks, and waits for the counted outcome.
  void ReloadAndAwait(const char* counter, const char* what) {
    const double before = Count(counter, what);
    reloader_->ReloadNow();
    EXPECT_TRUE(Await([&] { return Count(counter, what) > before; })) << counter << " " << what;
  }
  static constexpr char kDone[] = "robostress_reloads_total",
                        kFailed[] = "robostress_reload_failures_total";

  static inline TestCertificates* certificates_ = nullptr;
  Metrics metrics_;
  std::shared_ptr<TlsStore> tls_;
  std::shared_ptr<TokenStore> tokens_;
  std::unique_ptr<Reloader> reloader_;
};

TEST_F(ReloaderTest, TakesChangedTokensAndKeepsTheOldOnesWhenTheFileIsBroken) {
  const uint64_t before = tokens_->generation();
  EXPECT_TRUE(tokens_->Get()->Check("Bearer arm", Scope::kPredict).ok());
  WriteTokens("other_arm", "predict");
  ReloadAndAwait(kDone, "tokens");
  EXPECT_FALSE(tokens_->Get()->Check("Bearer arm", Scope::kPredict).ok());
  EXPECT_TRUE(tokens_->Get()->Check("Bearer other_arm", Scope::kPredict).ok());
  EXPECT_GT(tokens_->generation(), before);

  const uint64_t good = tokens_->generation();
  for (const char* broken : {"tokens: [{name: arm, sha2", "", "tokens: [{name: arm}]\n"}) {
    certificates_->Write("tokens.yaml", broken);
    ReloadAndAwait(kFailed, "tokens");
    EXPECT_TRUE(tokens_->Get()->Check("Bearer other_arm", Scope::kPredict).ok()) << broken;
  }
  std::filesystem::remove(certificates_->File("tokens.yaml"));
  ReloadAndAwait(kFailed, "tokens");
  EXPECT_EQ(tokens_->generation(), good);
  EXPECT_EQ(Count(kFailed, "tokens"), 4);
  EXPECT_EQ(Count(kFailed, "tls"), 0);
}

TEST_F(ReloaderTest, TakesAChangedCertificateWholeOrNotAtAll) {
  const std::string old = tls_->Get()->contents.certificate;
  const std::string whole = certificates_->Read("new.crt") + certificates_->Read("ca.crt");
  // A new certificate beside the old key; its chain cut off; half a key; half of the clients'
  // authorities.
  certificates_->Write("served.crt", whole);
  ReloadAndAwait(kFailed, "tls");
  certificates_->Write("served.key", certificates_->Read("new.key"));
  certificates_->Write("served.crt", whole.substr(0, whole.size() - 60));
  ReloadAndAwait(kFailed, "tls");
  certificates_->Write("served.crt", whole);
  certificates_->Write("served.key", certificates_->Read("new.key").substr(0, 100));
  ReloadAndAwait(kFailed, "tls");
  certificates_->Write("served.key", certificates_->Read("new.key"));
  const std::string authorities = certificates_->Read("ca.crt") + certificates_->Read("other.crt");
  certificates_->Write("served_ca.crt", authorities.substr(0, authorities.size() - 60));
  ReloadAndAwait(kFailed, "tls");
  EXPECT_EQ(tls_->generation(), 1u);
  EXPECT_EQ(tls_->Get()->contents.certificate, old);

  certificates_->Write("served_ca.crt", authorities);
  ReloadAndAwait(kDone, "tls");
  EXPECT_EQ(tls_->generation(), 2u);
  EXPECT_EQ(tls_->Get()->contents.certificate, whole);
  EXPECT_EQ(tls_->Get()->contents.client_ca, authorities);
  EXPECT_GT(metrics_.AddGauge("robostress_certificate_expiry_timestamp_seconds", "")->Value(),
            absl::ToDoubleSeconds(absl::Now() - absl::UnixEpoch()));
}

// Kubernetes and cert-manager replace the folder that a symlink names.
TEST_F(ReloaderTest, SeesFilesThatAreReplacedByASymlinkWithoutBeingAsked) {
  Start(absl::Seconds(1));
  namespace fs = std::filesystem;
  const fs::path folder = certificates_->File("data_new");
  fs::create_directories(folder);
  fs::rename(certificates_->File("served.crt"), folder / "served.crt");
  fs::rename(certificates_->File("served.key"), folder / "served.key");
  certificates_->Write("data_new/served.crt", certificates_->Read("new.crt"));
  certificates_->Write("data_new/served.key", certificates_->Read("new.key"));
  fs::create_symlink(folder / "served.key", certificates_->File("served.key"));
  fs::create_symlink(folder / "served.crt", certificates_->File("served.crt"));
  EXPECT_TRUE(
      Await([&] { return tls_->Get()->contents.certificate == certificates_->Read("new.crt"); }));
  fs::remove(certificates_->File("served.crt"));
  fs::remove(certificates_->File("served.key"));
}

TEST_F(ReloaderTest, RefusesAPeriodThatItCannotKeep) {
  for (const double seconds : {-1.0, 0.5, 1e9}) {
    ReloaderOptions options;
    options.period = absl::Seconds(seconds);
    EXPECT_THAT(
        std::string(Reloader::Start(options, nullptr, tokens_, &metrics_).status().message()),
        HasSubstr("--reload-seconds is "));
  }
}

TEST_F(ReloaderTest, TakesAKeyAsSystemdAndKubernetesGiveIt) {
  for (const mode_t mode : {0400u, 0440u, 0640u}) {
    chmod(certificates_->File("served.key").c_str(), mode);
    EXPECT_TRUE(ReadTlsFiles(certificates_->Files("served")).ok()) << mode;
  }
  chmod(certificates_->File("served.key").c_str(), 0444);
  EXPECT_FALSE(ReadTlsFiles(certificates_->Files("served")).ok());
}

}  // namespace
}  // namespace robostress
