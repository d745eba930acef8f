#pragma once

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "server/operations/tls_files.h"
#include "tests/run_program.h"

namespace robostress {

// Authorities and certificates for 127.0.0.1, made with the openssl program in a folder of their
// own: NAME.crt and NAME.key.
class TestCertificates {
 public:
  TestCertificates()
      : folder_(std::filesystem::path(::testing::TempDir()) /
                absl::StrCat("certificates-", getpid(), "-", ++count_)) {
    std::filesystem::create_directories(folder_);
    EXPECT_TRUE(WriteFileAtomically(File("san"), "subjectAltName=IP:127.0.0.1\n").ok());
  }
  ~TestCertificates() { std::filesystem::remove_all(folder_); }

  std::string File(const std::string& name) const { return (folder_ / name).string(); }
  std::string Read(const std::string& name) const { return *ReadFile(File(name)); }
  void Write(const std::string& name, const std::string& contents) const {
    EXPECT_TRUE(WriteFileAtomically(File(name), contents).ok());
    if (name.ends_with(".key")) chmod(File(name).c_str(), 0600);
  }
  void MakeAuthority(const std::string& name) const {
    Run(absl::StrCat("req -x509 ", kKey, " -days 2 -subj /CN=", name, " -keyout ", name,
                     ".key -out ", name, ".crt"));
  }
  void Make(const std::string& name, const std::string& authority) const {
    Run(absl::StrCat("req ", kKey, " -subj /CN=", name, " -keyout ", name, ".key -out ", name,
                     ".csr"));
    Run(absl::StrCat("x509 -req -days 2 -CAcreateserial -extfile san -in ", name, ".csr -CA ",
                     authority, ".crt -CAkey ", authority, ".key -out ", name, ".crt"));
    chmod(File(name + ".key").c_str(), 0600);
  }
  // As a server's files, `authority` empty: clients show no certificate.
  TlsFiles Files(const std::string& name, const std::string& authority = "") const {
    return {File(name + ".crt"), File(name + ".key"),
            authority.empty() ? "" : File(authority + ".crt")};
  }

 private:
  static constexpr char kKey[] = "-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes";
  void Run(const std::string& arguments) const {
    const auto [output, code] = RunProgram("cd " + File("") + " && openssl", arguments);
    ASSERT_EQ(code, 0) << output;
  }

  static inline int count_ = 0;
  const std::filesystem::path folder_;
};

}  // namespace robostress
