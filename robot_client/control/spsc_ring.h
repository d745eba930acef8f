#pragma once

#include <atomic>
#include <cstddef>
#include <utility>
#include <vector>

namespace robostress {

// A bounded queue from one thread to one other; neither side waits or allocates. When it is full
// Push refuses, and the sender counts that.
template <class T>
class SpscRing {
 public:
  explicit SpscRing(size_t capacity) : slots_(capacity + 1) {}

  bool Push(const T& value) {  // the sender's thread
    const size_t tail = tail_.load(std::memory_order_relaxed);
    const size_t next = Next(tail);
    if (next == head_.load(std::memory_order_acquire)) return false;
    slots_[tail] = value;
    tail_.store(next, std::memory_order_release);
    return true;
  }

  bool Pop(T& value) {  // the receiver's thread
    const size_t head = head_.load(std::memory_order_relaxed);
    if (head == tail_.load(std::memory_order_acquire)) return false;
    value = std::move(slots_[head]);  // what the value owns does not stay here
    head_.store(Next(head), std::memory_order_release);
    return true;
  }

  size_t capacity() const { return slots_.size() - 1; }

 private:
  size_t Next(size_t index) const { return index + 1 == slots_.size() ? 0 : index + 1; }

  std::vector<T> slots_;  // one stays empty
  alignas(64) std::atomic<size_t> head_{0};
  alignas(64) std::atomic<size_t> tail_{0};
};

}  // namespace robostress
