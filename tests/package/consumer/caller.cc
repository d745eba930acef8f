// Asks a policy server that is not there: the answer is an error that names the address.

#include <cstdio>
#include <cstdlib>
#include <string>

#include "common/rpc/policy_client.h"

int main() {
  robostress::PolicyClientOptions options;
  options.address = "127.0.0.1:1";
  options.connect_timeout_s = 0.2;
  const auto info = robostress::GetServerInfo(options);
  const std::string message(info.status().message());
  std::printf("%s\n", message.c_str());
  return !info.ok() && message.find(options.address) != std::string::npos ? EXIT_SUCCESS
                                                                          : EXIT_FAILURE;
}
