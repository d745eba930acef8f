#include "common/wire/web_url.h"

#include <algorithm>
#include <cstddef>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace robostress {

std::string WebUrl::authority() const {
  const bool colons = host.find(':') != std::string::npos;
  return absl::StrCat(colons ? "[" : "", host, colons ? "]:" : ":", port);
}

std::string WebUrl::text() const {
  return absl::StrCat(tls ? "wss://" : "ws://", authority(), target);
}

absl::StatusOr<WebUrl> ParseWebUrl(const std::string& text) {
  const auto refuse = [&text](const char* why) {
    return absl::InvalidArgumentError(
        absl::StrCat("'", text, "' ", why, "; give ws://HOST:PORT or wss://HOST:PORT"));
  };
  if (text.size() > 2048) return absl::InvalidArgumentError("an address of more than 2048 bytes");
  if (!std::all_of(text.begin(), text.end(), [](char c) { return c > ' ' && c < 127; }))
    return refuse("holds a space, or what is not ASCII");
  WebUrl url;
  std::string rest = text;
  if (const size_t scheme = text.find("://"); scheme != std::string::npos) {
    const std::string name = text.substr(0, scheme);
    if (!absl::EqualsIgnoreCase(name, "ws") && !absl::EqualsIgnoreCase(name, "wss"))
      return refuse("is neither ws:// nor wss://");
    url.tls = name.size() == 3;
    rest = text.substr(scheme + 3);
  }
  const size_t path = std::min(rest.find('/'), rest.find('?'));
  const std::string target = path == std::string::npos ? "" : rest.substr(path);
  url.target = absl::StartsWith(target, "/") ? target : absl::StrCat("/", target);
  rest = rest.substr(0, path);
  if (rest.find('@') != std::string::npos)
    return refuse("holds a name or password, which would stand on the command line");
  std::string port;
  if (!rest.empty() && rest.front() == '[') {
    const size_t end = rest.find(']');
    if (end == std::string::npos) return refuse("has a '[' without its ']'");
    url.host = rest.substr(1, end - 1);
    port = rest.substr(end + 1);
    if (!port.empty() && port.front() != ':') return refuse("has more than a port behind its ']'");
  } else {
    const size_t colon = rest.find(':');
    if (colon != rest.rfind(':')) return refuse("has an IPv6 address without [ ]");
    url.host = rest.substr(0, colon);
    if (colon != std::string::npos) port = rest.substr(colon);
  }
  if (url.host.empty()) return refuse("names no host");
  url.port = url.tls ? 443 : 80;
  if (!port.empty() &&
      (!absl::SimpleAtoi(port.substr(1), &url.port) || url.port < 1 || url.port > 65535))
    return refuse("has a port that is no number of 1 to 65535");
  return url;
}

}  // namespace robostress
