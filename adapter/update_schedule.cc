#include "adapter/update_schedule.h"

#include <numeric>
#include <utility>

#include "common/check.h"

namespace robostress {

bool UpdateSchedule::Add() {
  ++chunks_;
  return chunks_ >= buffer_chunks_ && (chunks_ - buffer_chunks_) % update_interval_ == 0;
}

std::vector<int> SampleWithoutReplacement(const StreamKey& key, int n, int count) {
  RS_CHECK(count >= 0 && count <= n);
  std::vector<int> indices(n);
  std::iota(indices.begin(), indices.end(), 0);
  RandomStream stream(key);
  for (int i = 0; i < count; ++i) std::swap(indices[i], indices[i + stream.UniformInt(n - i)]);
  indices.resize(count);
  return indices;
}

}  // namespace robostress
