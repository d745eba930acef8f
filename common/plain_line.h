#pragma once

#include <string>

#include "absl/strings/string_view.h"

// Text of others that goes to a terminal or into a table.
namespace robostress {

// Whether UTF-8 text can neither break its line nor steer a terminal: no control characters (U+0000
// to U+001F, U+007F to U+009F), no line separators (U+2028, U+2029), nothing that turns the
// direction of writing (U+202A to U+202E, U+2066 to U+2069).
bool IsPlainLine(absl::string_view utf8);
// The text with a space in place of each of these.
std::string PlainLine(absl::string_view utf8);

}  // namespace robostress
