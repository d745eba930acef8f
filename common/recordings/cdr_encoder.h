#pragma once

#include <bit>
#include <cstdint>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"

namespace robostress {

// A message of ROS 2 in CDR as most write it: XCDR1, little endian (common/recordings/cdr_decoder.h
// has the rules). Fields are added in the order of their type.
class CdrEncoder {
 public:
  template <class T>
  CdrEncoder& Number(T value) {
    static_assert(std::endian::native == std::endian::little);
    body_.append((sizeof(T) - body_.size() % sizeof(T)) % sizeof(T), '\0');
    body_.append(reinterpret_cast<const char*>(&value), sizeof(T));
    return *this;
  }
  CdrEncoder& Text(absl::string_view text) {
    Number(static_cast<uint32_t>(text.size() + 1)).body_.append(text.data(), text.size());
    body_ += '\0';
    return *this;
  }
  CdrEncoder& Texts(const std::vector<std::string>& texts) {
    Number(static_cast<uint32_t>(texts.size()));
    for (const std::string& text : texts) Text(text);
    return *this;
  }
  // An array of float64 of any length.
  template <class Values>
  CdrEncoder& Numbers(const Values& values) {
    Number(static_cast<uint32_t>(values.size()));
    for (const double value : values) Number(value);
    return *this;
  }
  // An array of uint8 of any length.
  CdrEncoder& Bytes(absl::string_view bytes) {
    Number(static_cast<uint32_t>(bytes.size())).body_.append(bytes.data(), bytes.size());
    return *this;
  }
  // std_msgs/Header; ROS takes a stamp of 0 for none.
  CdrEncoder& Header(int64_t stamp_ns, absl::string_view frame) {
    return Number(static_cast<int32_t>(stamp_ns / 1'000'000'000))
        .Number(static_cast<uint32_t>(stamp_ns % 1'000'000'000))
        .Text(frame);
  }
  std::string Message() const { return std::string("\0\1\0\0", 4) + body_; }

 private:
  std::string body_;
};

}  // namespace robostress
