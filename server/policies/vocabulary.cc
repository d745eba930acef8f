#include "server/policies/vocabulary.h"

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"

namespace robostress {

std::vector<std::string> SplitWords(const std::string& instruction) {
  std::vector<std::string> words;
  std::string word;
  const auto flush = [&] {
    while (!word.empty() && word.back() == '-') word.pop_back();
    if (!word.empty()) words.push_back(std::move(word));
    word.clear();
  };
  for (const char c : instruction) {
    if (absl::ascii_isalnum(c) || (c == '-' && !word.empty())) {
      word.push_back(absl::ascii_tolower(c));
    } else {
      flush();
    }
  }
  flush();
  return words;
}

Vocabulary::Vocabulary(std::vector<std::string> words) : words_(std::move(words)) {
  for (size_t i = 0; i < words_.size(); ++i)
    rows_[words_[i]] = kFirstWord + static_cast<int64_t>(i);
}

void Vocabulary::Add(const std::string& instruction) {
  for (std::string& word : SplitWords(instruction)) {
    if (rows_.emplace(word, kFirstWord + static_cast<int64_t>(words_.size())).second) {
      words_.push_back(std::move(word));
    }
  }
}

absl::StatusOr<std::vector<int64_t>> Vocabulary::Encode(const std::string& instruction,
                                                        int max_words) const {
  const std::vector<std::string> words = SplitWords(instruction);
  if (words.empty()) {
    return absl::InvalidArgumentError(absl::StrCat("instruction '", instruction, "' has no words"));
  }
  if (static_cast<int>(words.size()) > max_words) {
    return absl::InvalidArgumentError(absl::StrCat("instruction '", instruction, "' has ",
                                                   words.size(),
                                                   " words, the policy reads at most ", max_words));
  }
  std::vector<int64_t> rows(max_words, kPadding);
  for (size_t i = 0; i < words.size(); ++i) {
    const auto found = rows_.find(words[i]);
    rows[i] = found == rows_.end() ? kUnknown : found->second;
  }
  return rows;
}

std::vector<std::string> Vocabulary::Unknown(const std::string& instruction) const {
  std::vector<std::string> words = SplitWords(instruction);
  std::erase_if(words, [&](const std::string& word) { return rows_.count(word) > 0; });
  return words;
}

}  // namespace robostress
