#include "calib/json_integer.hpp"

#include <cstdint>
#include <limits>

#include "support/catch.hpp"

using namespace calib;
using nlohmann::json;

TEST_CASE("whole numbers that fit are read, at the ends of each type too") {
  CHECK(integer_from<int>(json(-7)) == -7);
  CHECK(integer_from<int>(json(7U)) == 7);
  for (const auto value : {std::numeric_limits<std::int64_t>::min(), std::numeric_limits<std::int64_t>::max()})
    CHECK(integer_from<std::int64_t>(json(value)) == value);
  CHECK(integer_from<std::uint64_t>(json(std::numeric_limits<std::uint64_t>::max())) ==
        std::numeric_limits<std::uint64_t>::max());
}

TEST_CASE("anything else is refused: no number is converted") {
  for (const json& value : {json(1e300), json(-1e300), json(1.0), json("1"), json(true), json(nullptr), json::array(),
                            json(std::numeric_limits<std::uint64_t>::max())}) {
    INFO(value.dump());
    CHECK_THROWS_AS(integer_from<std::int64_t>(value), std::invalid_argument);
  }
  CHECK_THROWS_AS(integer_from<std::uint64_t>(json(-1)), std::invalid_argument);
  CHECK_THROWS_AS(integer_from<int>(json(std::int64_t{1} << 31)), std::invalid_argument);
}
