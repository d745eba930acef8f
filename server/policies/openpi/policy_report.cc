#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "nlohmann/json.hpp"
#include "server/policies/openpi/policy_check.h"

namespace robostress::openpi {
namespace {

std::string Line(const QuantityResult& result, int width) {
  if (!result.known) {
    return absl::StrFormat("%-*s  %10s  %10s  %s\n", width, result.name, "-", "-",
                           "FAIL: unknown quantity, nothing here computes it");
  }
  const std::string tolerance =
      result.tolerance == 0 ? "exact" : absl::StrFormat("%.2e", result.tolerance);
  return absl::StrFormat("%-*s  %10.2e  %10s  %s\n", width, result.name, result.error, tolerance,
                         result.passed ? "ok" : "FAIL");
}

}  // namespace

std::string ReportText(const CheckReport& report) {
  size_t width = 0;
  for (const QuantityResult& result : report.results) width = std::max(width, result.name.size());
  std::string text = absl::StrFormat("%-*s  %10s  %10s  %s\n", static_cast<int>(width), "quantity",
                                     "error", "tolerance", "verdict");
  for (const QuantityResult& result : report.results) text += Line(result, static_cast<int>(width));
  const int64_t failed = report.num_failed();
  absl::StrAppend(&text, report.model, ": ", report.results.size(), " quantities, ",
                  failed == 0 ? "all within tolerance" : absl::StrCat(failed, " FAILED"), "\n");
  return text;
}

std::string ReportJson(const CheckOptions& options, const CheckReport& report) {
  nlohmann::ordered_json quantities = nlohmann::ordered_json::array();
  for (const QuantityResult& result : report.results) {
    nlohmann::ordered_json entry = {{"name", result.name}, {"shape", result.shape}};
    // JSON has no NaN: null, with the verdict beside it.
    entry["max_abs_error"] = result.known && std::isfinite(result.error)
                                 ? nlohmann::ordered_json(result.error)
                                 : nlohmann::ordered_json(nullptr);
    entry["tolerance"] =
        result.known ? nlohmann::ordered_json(result.tolerance) : nlohmann::ordered_json(nullptr);
    entry["verdict"] = result.passed ? "ok" : result.known ? "fail" : "unknown quantity";
    quantities.push_back(std::move(entry));
  }
  const nlohmann::ordered_json json = {{"model", report.model},
                                       {"weights", options.weights},
                                       {"io", options.io},
                                       {"lora", options.lora},
                                       {"passed", report.num_failed() == 0},
                                       {"num_failed", report.num_failed()},
                                       {"quantities", std::move(quantities)}};
  return json.dump(2, ' ', false, nlohmann::ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace robostress::openpi
