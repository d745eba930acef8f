// Clang reads this before a unit that GCC compiles. Nothing here is linked.
#pragma once

// LibTorch 1.13 (ATen/core/List.h) makes a std::vector of a type that is not complete. With C++20's
// constexpr vector Clang looks into it at once and refuses, GCC does not: read it without
// constexpr.
#include <memory>
#include <string>
#include <tuple>
// NOLINTBEGIN(bugprone-reserved-identifier): those of libstdc++
#pragma push_macro("_GLIBCXX20_CONSTEXPR")
#undef _GLIBCXX20_CONSTEXPR
#define _GLIBCXX20_CONSTEXPR
#define __fill_a1 __fill_a1_of_vector_bool  // <memory> has declared it constexpr
#include <vector>
#undef __fill_a1
#pragma pop_macro("_GLIBCXX20_CONSTEXPR")

// Clang 14 does not know all of GCC's names of processor features.
#define __builtin_cpu_supports(feature) (sizeof(feature) == 0)
// NOLINTEND(bugprone-reserved-identifier)
