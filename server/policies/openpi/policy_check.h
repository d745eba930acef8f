#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::openpi {

// Files of one case: weights with openpi's names, inputs and expected values.
struct CheckOptions {
  std::string weights;
  std::string io;  // inputs/* and expected/*
  std::string
      inputs;        // a file with inputs/* where io has none; empty: CASE.io.safetensors beside it
  std::string lora;  // lora/* and expected/*, which then replace those of io; empty: none
};

struct QuantityResult {
  std::string name;
  std::vector<int64_t> shape;
  double error = 0;      // largest |computed - expected|; NaN where either is not a number
  double tolerance = 0;  // 0: exact
  bool known = true;     // false: no such quantity is computed, which fails
  bool passed = false;
};

struct CheckReport {
  std::string model;                    // pi0 or pi0.5
  std::vector<QuantityResult> results;  // in the order of the computation
  int64_t num_failed() const;
};

// Computes every expected quantity of the files and compares. An error means that the files do not
// fit each other or cannot be read; it names file, tensor, value and remedy.
absl::StatusOr<CheckReport> CheckPolicy(const CheckOptions& options);

// A table with one line per quantity and a verdict at its end; the same as one JSON object.
std::string ReportText(const CheckReport& report);
std::string ReportJson(const CheckOptions& options, const CheckReport& report);

}  // namespace robostress::openpi
