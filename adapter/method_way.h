#pragma once

#include "absl/status/status.h"

namespace robostress {

// What the options of one way of compensating say of it. Such a struct, beside the way's code, has
//
//   static constexpr MethodWay kWay;
//   bool on() const;                  // false of a new one
//   bool carries_over() const;        // episodes depend on those before them
//   absl::Status Check() const;       // of options that are on; names key, value and range
//   template <class V> void Visit(V& v);                  // its keys, the first of them turns it
//   on using Corrector = ...;            // where it adds to commands (corrector.h)
//
// and stands in the list of method_options.h.
struct MethodWay {
  const char* name;            // of the way, and of the field of its state (state.proto)
  const char* key;             // the option that turns it on
  bool alone = false;          // goes with no other way
  bool in_joint_space = true;  // false: compares with a nominal end-effector controller
};

// INVALID_ARGUMENT where `value` is outside [low, high], or not a number.
absl::Status CheckOption(const char* key, double value, double low, double high);

}  // namespace robostress
