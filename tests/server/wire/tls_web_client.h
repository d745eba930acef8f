#pragma once

#include <gtest/gtest.h>
#include <openssl/ssl.h>

#include <string>

#include "tests/server/wire/web_client.h"

namespace robostress {

// A WebClient over TLS that trusts one authority.
class TlsWebClient : public WebClient {
 public:
  // PEM files; without `certificate` it shows none of its own.
  TlsWebClient(int port, const std::string& authority, const std::string& certificate = "",
               const std::string& key = "")
      : WebClient(port), context_(SSL_CTX_new(TLS_client_method())) {
    EXPECT_EQ(SSL_CTX_load_verify_locations(context_, authority.c_str(), nullptr), 1);
    SSL_CTX_set_verify(context_, SSL_VERIFY_PEER, nullptr);
    if (!certificate.empty()) {
      EXPECT_EQ(SSL_CTX_use_certificate_chain_file(context_, certificate.c_str()), 1);
      EXPECT_EQ(SSL_CTX_use_PrivateKey_file(context_, key.c_str(), SSL_FILETYPE_PEM), 1);
    }
    ssl_ = SSL_new(context_);
    SSL_set_fd(ssl_, fd());
    connected_ = SSL_connect(ssl_) == 1;
  }
  ~TlsWebClient() override {
    SSL_free(ssl_);
    SSL_CTX_free(context_);
  }
  // Of the client's side: under TLS 1.3 a refused certificate shows at the first answer.
  bool connected() const { return connected_; }

 private:
  ssize_t Write(const char* bytes, size_t size) override {
    return SSL_write(ssl_, bytes, static_cast<int>(size));
  }
  ssize_t ReadSome(char* bytes, size_t size) override {
    return SSL_read(ssl_, bytes, static_cast<int>(size));
  }

  SSL_CTX* const context_;
  SSL* ssl_ = nullptr;
  bool connected_ = false;
};

}  // namespace robostress
