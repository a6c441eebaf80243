#include "calib/error_code.hpp"

#include <algorithm>
#include <set>
#include <string>

#include "support/catch.hpp"

namespace calib {
namespace {

bool is_snake_case(std::string_view word) {
  return !word.empty() && word.front() >= 'a' && word.front() <= 'z' && word.back() != '_' &&
         word.find("__") == std::string_view::npos &&
         std::ranges::all_of(word, [](char c) { return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_'; });
}

TEST_CASE("every error code has its own word, which is read back") {
  std::set<std::string_view> words;
  for (std::size_t i = 0; i < all_error_codes.size(); ++i) {
    const ErrorCode code = all_error_codes[i];
    REQUIRE(static_cast<std::size_t>(code) == i);
    const std::string_view word = to_string(code);
    INFO(word);
    CHECK(words.insert(word).second);
    CHECK(parse_error_code(word) == code);
  }
  CHECK_FALSE(parse_error_code(""));
  CHECK_FALSE(parse_error_code("malformed:"));
  CHECK_FALSE(parse_error_code("malformed_point_step"));
  CHECK_FALSE(parse_error_code("of a later version"));
}

TEST_CASE("an error code's word is snake_case, with a detail after a colon for malformed messages only") {
  for (const ErrorCode code : all_error_codes) {
    const std::string_view word = to_string(code);
    INFO(word);
    const auto colon = word.find(':');
    CHECK(is_snake_case(word.substr(0, colon)));
    CHECK(is_malformed(code) == (colon != std::string_view::npos));
    if (colon == std::string_view::npos) continue;
    CHECK(word.substr(0, colon) == "malformed");
    CHECK(is_snake_case(word.substr(colon + 1)));
  }
  CHECK(to_string(ErrorCode::low_overlap) == "low_overlap");
  CHECK(to_string(ErrorCode::malformed_point_step) == "malformed:point_step");
}

}  // namespace
}  // namespace calib
