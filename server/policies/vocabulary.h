#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// Splits an instruction into lower-case words: letters, digits and inner hyphens; all else
// separates.
std::vector<std::string> SplitWords(const std::string& instruction);

// Words of a policy's instructions. Row 0 of the word table is padding, row 1 every unknown word,
// row 2 + i is words[i].
class Vocabulary {
 public:
  static constexpr int64_t kPadding = 0, kUnknown = 1, kFirstWord = 2;

  Vocabulary() = default;
  explicit Vocabulary(std::vector<std::string> words);

  const std::vector<std::string>& words() const { return words_; }
  // Adds the words of an instruction that are not there yet.
  void Add(const std::string& instruction);
  // Row indices padded to max_words; an empty instruction or one that is too long is an error.
  absl::StatusOr<std::vector<int64_t>> Encode(const std::string& instruction, int max_words) const;
  // Of an instruction the words that it lacks; a policy cannot tell them from each other.
  std::vector<std::string> Unknown(const std::string& instruction) const;

 private:
  std::vector<std::string> words_;
  std::map<std::string, int64_t> rows_;
};

}  // namespace robostress
