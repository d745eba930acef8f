#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace robostress {

// The identity of a random stream, built from named parts: a draw depends on the key and on its
// index, never on the order in which streams are used. Equal parts in equal order give equal keys.
class StreamKey {
 public:
  explicit StreamKey(std::string_view purpose);
  StreamKey With(std::string_view part) const;
  StreamKey With(int64_t part) const;
  uint64_t lo() const { return lo_; }
  uint64_t hi() const { return hi_; }

 private:
  uint64_t lo_ = 0, hi_ = 0;
};

// Philox4x32 with ten rounds (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC'11).
std::array<uint32_t, 4> Philox4x32(std::array<uint32_t, 4> counter, std::array<uint32_t, 2> key);

// Counter-based stream: Philox4x32-10 keyed by a StreamKey.
class RandomStream {
 public:
  explicit RandomStream(const StreamKey& key);
  uint32_t NextUint32();
  double Uniform();  // [0, 1), 53 bits
  double Uniform(double low, double high);
  double Normal();        // Box-Muller, N(0, 1)
  int UniformInt(int n);  // 0 .. n-1, unbiased; n >= 1

 private:
  void Refill();
  std::array<uint32_t, 2> key_;
  std::array<uint32_t, 4> counter_;
  std::array<uint32_t, 4> block_;
  int next_ = 4;
  bool has_spare_ = false;
  double spare_ = 0;
};

}  // namespace robostress
