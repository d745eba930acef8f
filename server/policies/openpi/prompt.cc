#include "server/policies/openpi/prompt.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress::openpi {
namespace {

constexpr int64_t kHalfBins = 128;

}  // namespace

std::string CleanInstruction(const std::string& instruction) {
  std::string text(absl::StripAsciiWhitespace(instruction));
  std::replace(text.begin(), text.end(), '_', ' ');
  std::replace(text.begin(), text.end(), '\n', ' ');
  return text;
}

std::vector<int64_t> StateBins(absl::Span<const double> state) {
  std::vector<int64_t> bins;
  for (const double x : state) {
    // Clamped first: beyond [-2, 2] nothing changes, and a large value would not fit an integer.
    // The product with a power of two is exact, so the floor compares with the edges themselves.
    const double edge = std::floor(std::clamp(x, -2.0, 2.0) * kHalfBins);
    bins.push_back(
        std::clamp<int64_t>(static_cast<int64_t>(edge) + kHalfBins, -1, 2 * kHalfBins - 1));
  }
  return bins;
}

std::string PromptText(PromptFormat format, const std::string& instruction,
                       absl::Span<const double> state) {
  const std::string text = CleanInstruction(instruction);
  if (format == PromptFormat::kText) return text;
  return absl::StrCat("Task: ", text, ", State: ", absl::StrJoin(StateBins(state), " "),
                      ";\nAction: ");
}

absl::StatusOr<Prompt> MakePrompt(const Tokenizer& tokenizer, PromptFormat format, int64_t length,
                                  const std::string& instruction, absl::Span<const double> state) {
  Prompt prompt;
  prompt.ids = {tokenizer.bos()};
  RS_ASSIGN_OR_RETURN(const std::vector<int64_t> text,
                      tokenizer.Encode(PromptText(format, instruction, state)));
  prompt.ids.insert(prompt.ids.end(), text.begin(), text.end());
  if (format == PromptFormat::kText) {
    RS_ASSIGN_OR_RETURN(const std::vector<int64_t> newline, tokenizer.Encode("\n"));
    prompt.ids.insert(prompt.ids.end(), newline.begin(), newline.end());
  }
  const auto tokens = static_cast<int64_t>(prompt.ids.size());
  prompt.used = std::min(tokens, length);
  prompt.cut = tokens - prompt.used;
  prompt.ids.resize(length, 0);
  return prompt;
}

}  // namespace robostress::openpi
