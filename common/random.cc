#include "common/random.h"

#include <cmath>
#include <numbers>

namespace robostress {
namespace {

constexpr uint64_t kFnvPrime = 0x100000001b3ULL;

// splitmix64's finaliser.
uint64_t Mix(uint64_t x) {
  x ^= x >> 30;
  x *= 0xbf58476d1ce4e5b9ULL;
  x ^= x >> 27;
  x *= 0x94d049bb133111ebULL;
  return x ^ (x >> 31);
}

uint64_t HashBytes(std::string_view bytes, uint64_t hash) {
  for (const char c : bytes) hash = (hash ^ static_cast<uint8_t>(c)) * kFnvPrime;
  return hash;
}

}  // namespace

StreamKey::StreamKey(std::string_view purpose)
    : lo_(Mix(HashBytes(purpose, 0xcbf29ce484222325ULL))),
      hi_(Mix(HashBytes(purpose, 0x9ae16a3b2f90404fULL))) {}

// The tags keep "1" apart from 1.
StreamKey StreamKey::With(std::string_view part) const {
  StreamKey key = *this;
  key.lo_ = Mix(HashBytes(part, lo_ ^ 0x5353535353535353ULL) + part.size());
  key.hi_ = Mix(HashBytes(part, hi_ ^ 0x5454545454545454ULL) + part.size());
  return key;
}

StreamKey StreamKey::With(int64_t part) const {
  StreamKey key = *this;
  key.lo_ = Mix(lo_ + 0x9e3779b97f4a7c15ULL * (static_cast<uint64_t>(part) + 1));
  key.hi_ = Mix((hi_ ^ static_cast<uint64_t>(part)) * 0xd6e8feb86659fd93ULL + 1);
  return key;
}

RandomStream::RandomStream(const StreamKey& key)
    : key_{static_cast<uint32_t>(key.lo()), static_cast<uint32_t>(key.lo() >> 32)},
      counter_{0, 0, static_cast<uint32_t>(key.hi()), static_cast<uint32_t>(key.hi() >> 32)},
      block_{} {}

std::array<uint32_t, 4> Philox4x32(std::array<uint32_t, 4> x, std::array<uint32_t, 2> k) {
  for (int round = 0; round < 10; ++round) {
    const uint64_t product0 = uint64_t{0xD2511F53} * x[0];
    const uint64_t product1 = uint64_t{0xCD9E8D57} * x[2];
    x = {static_cast<uint32_t>(product1 >> 32) ^ x[1] ^ k[0], static_cast<uint32_t>(product1),
         static_cast<uint32_t>(product0 >> 32) ^ x[3] ^ k[1], static_cast<uint32_t>(product0)};
    k[0] += 0x9E3779B9;
    k[1] += 0xBB67AE85;
  }
  return x;
}

void RandomStream::Refill() {
  block_ = Philox4x32(counter_, key_);
  if (++counter_[0] == 0) ++counter_[1];
  next_ = 0;
}

uint32_t RandomStream::NextUint32() {
  if (next_ == 4) Refill();
  return block_[next_++];
}

double RandomStream::Uniform() {
  const uint64_t high = NextUint32() >> 5;  // 27 bits
  const uint64_t low = NextUint32() >> 6;   // 26 bits
  return static_cast<double>((high << 26) | low) * 0x1.0p-53;
}

double RandomStream::Uniform(double low, double high) { return low + (high - low) * Uniform(); }

double RandomStream::Normal() {
  if (has_spare_) {
    has_spare_ = false;
    return spare_;
  }
  const double radius = std::sqrt(-2.0 * std::log(1.0 - Uniform()));
  const double angle = 2.0 * std::numbers::pi * Uniform();
  spare_ = radius * std::sin(angle);
  has_spare_ = true;
  return radius * std::cos(angle);
}

int RandomStream::UniformInt(int n) {
  const uint32_t range = static_cast<uint32_t>(n);
  const uint32_t limit = UINT32_MAX - UINT32_MAX % range;  // rejects the incomplete last interval
  uint32_t draw = NextUint32();
  while (draw >= limit) draw = NextUint32();
  return static_cast<int>(draw % range);
}

}  // namespace robostress
