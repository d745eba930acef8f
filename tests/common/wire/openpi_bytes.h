#pragma once

#include <cstdint>
#include <cstring>
#include <string>
#include <vector>

namespace robostress {

// openpi's messages byte by byte, from the documented format and without the server's own code, so
// that a mistake in the one does not hide in the other.
class OpenpiBytes {
 public:
  OpenpiBytes& Byte(int value) {
    bytes_.push_back(static_cast<char>(value));
    return *this;
  }
  OpenpiBytes& Big(uint64_t value, int size) {  // network order
    for (int i = size - 1; i >= 0; --i) Byte(static_cast<int>(value >> (8 * i) & 0xff));
    return *this;
  }
  OpenpiBytes& Map(int pairs) { return pairs < 16 ? Byte(0x80 | pairs) : Byte(0xde).Big(pairs, 2); }
  OpenpiBytes& Text(const std::string& text) {
    if (text.size() < 32) {
      Byte(0xa0 | static_cast<int>(text.size()));
    } else {
      Byte(0xd9).Big(text.size(), 1);
    }
    bytes_ += text;
    return *this;
  }
  OpenpiBytes& Bin(const std::string& data) {
    if (data.size() < 256) {
      Byte(0xc4).Big(data.size(), 1);
    } else if (data.size() < 65536) {
      Byte(0xc5).Big(data.size(), 2);
    } else {
      Byte(0xc6).Big(data.size(), 4);
    }
    bytes_ += data;
    return *this;
  }
  OpenpiBytes& Integer(uint64_t value) {
    return value < 128 ? Byte(static_cast<int>(value)) : Byte(0xcf).Big(value, 8);
  }
  OpenpiBytes& True() { return Byte(0xc3); }
  // What msgpack-numpy of openpi's client makes of an array: keys are bytes, not text.
  OpenpiBytes& Array(const std::string& dtype, const std::vector<int>& shape,
                     const std::string& data) {
    Byte(0x84)
        .Bin("__ndarray__")
        .True()
        .Bin("data")
        .Bin(data)
        .Bin("dtype")
        .Text(dtype)
        .Bin("shape");
    Byte(0x90 | static_cast<int>(shape.size()));
    for (const int size : shape) Integer(static_cast<uint64_t>(size));
    return *this;
  }
  template <class T>
  OpenpiBytes& Numbers(const std::string& dtype, const std::vector<int>& shape,
                       const std::vector<T>& values) {
    return Array(dtype, shape,
                 {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(T)});
  }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_;
};

}  // namespace robostress
