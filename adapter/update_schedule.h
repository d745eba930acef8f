#pragma once

#include <cstdint>
#include <vector>

#include "common/random.h"

namespace robostress {

// When an update is due (paper, sec:supp_method): at the chunk that fills the buffer, then every
// `update_interval` chunks: 32, 40, 48, ... since the last clear.
class UpdateSchedule {
 public:
  UpdateSchedule(int buffer_chunks, int update_interval)
      : buffer_chunks_(buffer_chunks), update_interval_(update_interval) {}

  // Counts one chunk; true when it triggers an update.
  bool Add();
  void Clear() { chunks_ = 0; }
  int64_t chunks() const { return chunks_; }  // since the last clear
  void set_chunks(int64_t chunks) { chunks_ = chunks; }

 private:
  int64_t buffer_chunks_, update_interval_;
  int64_t chunks_ = 0;
};

// `count` different indices of 0 .. n-1 in the order drawn; a function of the key alone. 0 <= count
// <= n.
std::vector<int> SampleWithoutReplacement(const StreamKey& key, int n, int count);

}  // namespace robostress
