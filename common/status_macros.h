#pragma once

#include <utility>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

#define RS_CONCAT_INNER(a, b) a##b
#define RS_CONCAT(a, b) RS_CONCAT_INNER(a, b)

// Returns from the enclosing function when `expr`, an absl::Status, is not OK.
#define RS_RETURN_IF_ERROR(expr)                                            \
  do {                                                                      \
    if (absl::Status rs_status = (expr); !rs_status.ok()) return rs_status; \
  } while (false)

// Evaluates `expr`, an absl::StatusOr<T>; assigns its value to `lhs` or returns its status.
#define RS_ASSIGN_OR_RETURN(lhs, expr) \
  RS_ASSIGN_OR_RETURN_IMPL(RS_CONCAT(rs_status_or_, __LINE__), lhs, expr)
// NOLINTBEGIN(bugprone-macro-parentheses): names and a declaration take none.
#define RS_ASSIGN_OR_RETURN_IMPL(status_or, lhs, expr) \
  auto status_or = (expr);                             \
  if (!status_or.ok()) return status_or.status();      \
  lhs = std::move(status_or).value()
// NOLINTEND(bugprone-macro-parentheses)
