#pragma once

// Catch2 version 3 (Debian 13, Ubuntu 24.04) or 2 (Debian 12), with the names that the tests use made the same.
#if __has_include(<catch2/catch_all.hpp>)
#include <catch2/catch_all.hpp>
using Catch::Approx;
#else
#include <catch2/catch.hpp>
#include <string>
namespace Catch::Matchers {
inline auto ContainsSubstring(const std::string& text) { return Contains(text); }
}  // namespace Catch::Matchers
#endif

#include "calib/error_code.hpp"

namespace calib {

inline std::string word(ErrorCode code) { return std::string(to_string(code)); }
/// Tests compare a code with its word as it is on the wire; sources compare enumerators.
inline bool operator==(ErrorCode code, std::string_view word) { return to_string(code) == word; }

}  // namespace calib

template <>
struct Catch::StringMaker<calib::ErrorCode> {
  static std::string convert(calib::ErrorCode code) { return calib::word(code); }
};
