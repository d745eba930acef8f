#include "tests/fuzz/splice_mutator.h"

#include <algorithm>
#include <cstring>
#include <random>
#include <string>

extern "C" size_t LLVMFuzzerMutate(uint8_t* data, size_t size, size_t max_size);

namespace robostress {

size_t MutateBetween(const std::vector<size_t>& boundaries, uint8_t* data, size_t size,
                     size_t max_size, unsigned int seed) {
  std::minstd_rand random(seed);
  if (boundaries.size() < 3 || random() % 2 == 0) return LLVMFuzzerMutate(data, size, max_size);
  auto pick = [&] { return boundaries[random() % boundaries.size()]; };
  size_t begin = pick(), end = pick();
  if (begin > end) std::swap(begin, end);
  std::string text(reinterpret_cast<const char*>(data), size);
  const std::string span = text.substr(begin, end - begin);
  enum Action { kDelete, kMove, kRepeat, kRepeatOften };
  const auto action = static_cast<Action>(random() % 4);
  size_t copies = action == kDelete ? 0 : 1;
  if (action == kRepeatOften) copies = size_t{1} << random() % 17;
  if (!span.empty()) copies = std::min(copies, max_size / span.size());
  std::string inserted;
  for (size_t i = 0; i < copies; ++i) inserted += span;
  if (action == kDelete || action == kMove) text.erase(begin, span.size());
  text.insert(std::min(pick(), text.size()), inserted);
  text.resize(std::min(text.size(), max_size));
  std::memcpy(data, text.data(), text.size());
  return text.size();
}

}  // namespace robostress
