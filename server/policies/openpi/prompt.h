#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "server/policies/openpi/tokenizer.h"

namespace robostress::openpi {

// What the text of a prompt holds.
enum class PromptFormat {
  kText,          // BOS, text, newline: pi0; pi0.5 without discrete state
  kTextAndState,  // BOS, "Task: TEXT, State: B0 B1 ...;\nAction: ": pi0.5 with discrete state
};

// Ids padded with 0 to a fixed length; the first `used` are the prompt.
struct Prompt {
  std::vector<int64_t> ids;
  int64_t used = 0;
  int64_t cut = 0;  // tokens that did not fit and are lost, from the end
};

// openpi's cleaning: ASCII white space at both ends is dropped, '_' and newlines within become
// spaces.
std::string CleanInstruction(const std::string& instruction);

// The bin of each entry of a normalised state among 256 equal ones over [-1, 1]: the number of
// edges -1 + i / 128 that are not above it, minus one. So 255 at and above 1 - 1/128, and -1 (not
// 0) below -1: openpi does not clip, and its prompts say "-1".
std::vector<int64_t> StateBins(absl::Span<const double> state);

// The text that is tokenised. `state` is normalised; kText ignores it.
std::string PromptText(PromptFormat format, const std::string& instruction,
                       absl::Span<const double> state);

// Tokens of PromptText behind BOS; what exceeds `length` is cut off, as openpi does. kText has its
// newline tokenised apart from the text.
absl::StatusOr<Prompt> MakePrompt(const Tokenizer& tokenizer, PromptFormat format, int64_t length,
                                  const std::string& instruction, absl::Span<const double> state);

}  // namespace robostress::openpi
