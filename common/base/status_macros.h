// Early return on a failed absl::Status or absl::StatusOr.

#pragma once

#include <utility>

#include <absl/status/status.h>
#include <absl/status/statusor.h>

// Returns from the enclosing function when `expr`, an absl::Status, is not ok.
#define CRAFTFLEET_RETURN_IF_ERROR(expr)                                                            \
  do {                                                                                              \
    if (absl::Status craftfleet_status = (expr); !craftfleet_status.ok()) return craftfleet_status; \
  } while (false)

// CRAFTFLEET_ASSIGN_OR_RETURN(auto x, Compute()): the value, or return of its status.
#define CRAFTFLEET_ASSIGN_OR_RETURN(lhs, expr) \
  CRAFTFLEET_ASSIGN_OR_RETURN_IMPL_(CRAFTFLEET_CONCAT_(craftfleet_or_, __LINE__), lhs, expr)

// NOLINTBEGIN(bugprone-macro-parentheses): `lhs` may be a declaration.
#define CRAFTFLEET_CONCAT_INNER_(a, b) a##b
#define CRAFTFLEET_CONCAT_(a, b) CRAFTFLEET_CONCAT_INNER_(a, b)
#define CRAFTFLEET_ASSIGN_OR_RETURN_IMPL_(result, lhs, expr) \
  auto result = (expr);                                      \
  if (!result.ok()) return std::move(result).status();       \
  lhs = *std::move(result)
// NOLINTEND(bugprone-macro-parentheses)
