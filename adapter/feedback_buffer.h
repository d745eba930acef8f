#pragma once

#include <deque>
#include <utility>

#include "common/check.h"

namespace robostress {

// The most recent `capacity` items, oldest first; adding to a full buffer drops the oldest.
template <class Item>
class FeedbackBuffer {
 public:
  explicit FeedbackBuffer(int capacity) : capacity_(capacity) { RS_CHECK(capacity >= 1); }

  void Add(Item item) {
    if (size() == capacity_) items_.pop_front();
    items_.push_back(std::move(item));
  }
  void Clear() { items_.clear(); }
  int size() const { return static_cast<int>(items_.size()); }
  int capacity() const { return capacity_; }
  const Item& operator[](int i) const {
    RS_CHECK(i >= 0 && i < size());
    return items_[i];
  }

 private:
  int capacity_;
  std::deque<Item> items_;
};

}  // namespace robostress
