// The reader of token files and of what callers show. The first line is the header, the rest the
// file.
#include "common/atomic_file.h"
#include "server/operations/access_tokens.h"
#include "tests/fuzz/fuzz_check.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const std::string text(reinterpret_cast<const char*>(data), size);
  const size_t line = text.find('\n');
  const std::string header = text.substr(0, line);
  const std::string file = line == std::string::npos ? "" : text.substr(line + 1);
  const auto tokens = AccessTokens::Parse("tokens.yaml", file);
  if (!tokens.ok()) {
    CheckRefusal(tokens.status(), "tokens.yaml");
    return 0;
  }
  FuzzCheck(tokens->required(), "a file that asks for nothing");
  const auto caller = tokens->Authenticate(header);
  if (!caller.ok()) return 0;
  const std::string shown = header.substr(header.find(' ') + 1);
  FuzzCheck(
      file.find(Sha256Hex(shown)) != std::string::npos || header[0] == 'b' || header[0] == 'B',
      "a token that the file does not hold");
  return 0;
}
