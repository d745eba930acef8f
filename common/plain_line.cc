#include "common/plain_line.h"

namespace robostress {
namespace {

// Bytes of the character at the start of `text` that a plain line has not; 0 where it has it.
size_t UnplainBytes(absl::string_view text) {
  const auto byte = [text](size_t i) {
    return i < text.size() ? static_cast<unsigned char>(text[i]) : 0;
  };
  if (byte(0) < 0x20 || byte(0) == 0x7F) return 1;
  if (byte(0) == 0xC2 && byte(1) >= 0x80 && byte(1) <= 0x9F) return 2;  // C1
  if (byte(0) != 0xE2) return 0;
  if (byte(1) == 0x80 && byte(2) >= 0xA8 && byte(2) <= 0xAE) return 3;  // U+2028 to U+202E
  if (byte(1) == 0x81 && byte(2) >= 0xA6 && byte(2) <= 0xA9) return 3;  // U+2066 to U+2069
  return 0;
}

}  // namespace

bool IsPlainLine(absl::string_view utf8) {
  for (size_t i = 0; i < utf8.size(); ++i) {
    if (UnplainBytes(utf8.substr(i)) > 0) return false;
  }
  return true;
}

std::string PlainLine(absl::string_view utf8) {
  std::string line;
  while (!utf8.empty()) {
    const size_t unplain = UnplainBytes(utf8);
    line += unplain > 0 ? ' ' : utf8.front();
    utf8.remove_prefix(unplain > 0 ? unplain : 1);
  }
  return line;
}

}  // namespace robostress
