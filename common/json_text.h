#pragma once

#include <string>
#include <string_view>

#include "absl/status/statusor.h"
#include "nlohmann/json.hpp"

namespace robostress {

// Parses a JSON object that someone else wrote. Refuses other text, nesting deeper than `max_depth`
// and a key that occurs twice in one object (which nlohmann's parser would merge silently). The
// message names key or depth, the caller adds the file.
absl::StatusOr<nlohmann::json> ParseJsonObject(std::string_view text, int max_depth = 16);

// The text at `key`; empty where `json` is no object, or holds nothing or no text there.
std::string TextAt(const nlohmann::json& json, const char* key);

}  // namespace robostress
