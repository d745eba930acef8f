#include "robot_client/piper/firmware.h"

#include <cctype>

#include "absl/strings/str_format.h"

namespace robostress::piper {
namespace {

// Reads at most three digits off the front.
std::optional<int> TakeNumber(std::string_view& text) {
  int value = 0;
  size_t digits = 0;
  while (digits < text.size() && digits < 3 &&
         std::isdigit(static_cast<unsigned char>(text[digits])))
    value = 10 * value + (text[digits++] - '0');
  if (digits == 0) return std::nullopt;
  text.remove_prefix(digits);
  return value;
}

bool TakeChar(std::string_view& text, char c) {
  if (text.empty() || text.front() != c) return false;
  text.remove_prefix(1);
  return true;
}

}  // namespace

std::optional<Firmware> ParseFirmware(std::string_view text) {
  const size_t start = text.find("S-V");
  if (start == std::string_view::npos) return std::nullopt;
  text.remove_prefix(start + 3);
  const auto major = TakeNumber(text);
  if (!major || !TakeChar(text, '.')) return std::nullopt;
  const auto minor = TakeNumber(text);
  if (!minor || !TakeChar(text, '-')) return std::nullopt;
  const auto patch = TakeNumber(text);
  if (!patch) return std::nullopt;
  return Firmware{*major, *minor, *patch};
}

std::string FirmwareName(const Firmware& firmware) {
  return absl::StrFormat("S-V%d.%d-%d", firmware.major, firmware.minor, firmware.patch);
}

double CurrentScale(const Firmware& firmware, int joint) {
  return joint < 3 && firmware <= Firmware{1, 8, 2} ? 4 : 1;
}

}  // namespace robostress::piper
