#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/types.h"

namespace robostress {

// Writes one message. Map(n) is followed by n pairs of a key and a value.
class OpenpiWriter {
 public:
  // Of an array's own keys: openpi's bytes, or text as vla-eval's.
  enum class ArrayKeys { kBytes, kText };
  explicit OpenpiWriter(ArrayKeys keys = ArrayKeys::kBytes) : keys_(keys) {}

  OpenpiWriter& Map(uint32_t pairs);
  OpenpiWriter& List(uint32_t items);
  OpenpiWriter& Text(std::string_view text);  // keys too
  OpenpiWriter& Integer(int64_t value);
  OpenpiWriter& Real(double value);
  OpenpiWriter& Boolean(bool value);
  // As an array "<f4" of shape [rows, cols] with openpi's bin keys. openpi's chunk broker cuts
  // every array of a reply by step: only chunks may be arrays.
  OpenpiWriter& Array(const Eigen::MatrixXf& matrix);
  // As an array "<f8" of shape [numbers].
  OpenpiWriter& Numbers(const std::vector<double>& numbers);
  // As an array "|u1" of shape [height, width, 3], or [3, height, width].
  OpenpiWriter& Pixels(const Image& image, bool planes_first);
  // As vla-eval's map of a PNG, whose sides are [px].
  OpenpiWriter& Png(std::string_view png, int width, int height);
  // A value that another writer wrote.
  OpenpiWriter& Value(std::string_view written);
  // What is written will take about so many bytes: they are found once.
  void Reserve(size_t bytes) { bytes_.reserve(bytes); }
  const std::string& bytes() const { return bytes_; }
  std::string Take() { return std::move(bytes_); }

 private:
  // The map around an array's bytes, up to its data, and what follows them.
  void BeginArray(size_t bytes);
  OpenpiWriter& EndArray(std::string_view dtype, std::initializer_list<int64_t> shape);
  void ArrayKey(std::string_view text);

  const ArrayKeys keys_;
  std::string bytes_;
};

}  // namespace robostress
