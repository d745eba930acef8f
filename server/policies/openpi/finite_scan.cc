#include "server/policies/openpi/finite_scan.h"

#include <algorithm>
#include <cstring>

#include "common/check.h"

namespace robostress::openpi {
namespace {

constexpr int64_t kBlock = 4096;  // elements; a constant trip count lets the compiler vectorise

// An exponent of ones is an infinity or a NaN.
template <class Bits>
bool AllFinite(const Bits* values, int64_t count, Bits exponent) {
  Bits bad = 0;
  for (int64_t i = 0; i < count; ++i) bad |= (values[i] & exponent) == exponent;
  return bad == 0;
}

template <class Bits>
int64_t Scan(absl::Span<const uint8_t> bytes, Bits exponent) {
  const int64_t total = static_cast<int64_t>(bytes.size() / sizeof(Bits));
  Bits block[kBlock];
  for (int64_t begin = 0; begin < total; begin += kBlock) {
    const int64_t count = std::min(kBlock, total - begin);
    std::memcpy(block, bytes.data() + begin * sizeof(Bits), count * sizeof(Bits));
    const bool finite =
        count == kBlock ? AllFinite(block, kBlock, exponent) : AllFinite(block, count, exponent);
    if (finite) continue;
    for (int64_t i = 0; i < count; ++i) {
      if ((block[i] & exponent) == exponent) return begin + i;
    }
  }
  return -1;
}

}  // namespace

int64_t FirstNotFinite(DType dtype, absl::Span<const uint8_t> bytes) {
  switch (dtype) {
    case DType::kF32:
      return Scan<uint32_t>(bytes, 0x7F800000);
    case DType::kBF16:
      return Scan<uint16_t>(bytes, 0x7F80);
    case DType::kF16:
      return Scan<uint16_t>(bytes, 0x7C00);
    default:
      RS_CHECK(false);
      return -1;
  }
}

}  // namespace robostress::openpi
