#include "calib/axis_words.hpp"

#include <limits>

#include "calib/geometry.hpp"
#include "support/catch.hpp"

using namespace calib;

TEST_CASE("a motion is told in degrees or centimetres with the side to which it goes") {
  const double degree = radians_per_degree;
  CHECK(motion_in_words(0, 1.25 * degree) == "1.25 degrees right side down");
  CHECK(motion_in_words(0, -1.25 * degree) == "1.25 degrees left side down");
  CHECK(motion_in_words(1, 0.5 * degree) == "0.50 degrees nose down");
  CHECK(motion_in_words(1, -0.5 * degree) == "0.50 degrees nose up");
  CHECK(motion_in_words(2, 0.62 * degree) == "0.62 degrees to the left");
  CHECK(motion_in_words(2, -0.62 * degree) == "0.62 degrees to the right");
  CHECK(motion_in_words(3, 0.031) == "3.1 cm forward");
  CHECK(motion_in_words(3, -0.031) == "3.1 cm back");
  CHECK(motion_in_words(4, 0.2) == "20.0 cm to the left");
  CHECK(motion_in_words(4, -0.2) == "20.0 cm to the right");
  CHECK(motion_in_words(5, 1) == "100.0 cm up");
  CHECK(motion_in_words(5, -1) == "100.0 cm down");
}

TEST_CASE("a motion that is rounded to zero has no side") {
  CHECK(motion_in_words(2, 0) == "0.00 degrees");
  CHECK(motion_in_words(2, -0.004 * radians_per_degree) == "0.00 degrees");
  CHECK(motion_in_words(4, 0.0004) == "0.0 cm");
}

TEST_CASE("the standard deviation follows where it is known") {
  CHECK(motion_in_words(2, 0.62 * radians_per_degree, 0.05 * radians_per_degree) ==
        "0.62 degrees to the left, sigma 0.05");
  CHECK(motion_in_words(3, 0, 0.012) == "0.0 cm, sigma 1.2");
}

TEST_CASE("an amount alone is a number without sign and unit") {
  CHECK(amount_in_words(1, -0.5 * radians_per_degree) == "0.50");
  CHECK(amount_in_words(5, -0.5) == "50.0");
}

TEST_CASE("the largest numbers and those that are none are written, too") {
  CHECK(amount_in_words(3, std::numeric_limits<double>::max() / 100).size() == 311);
  CHECK(amount_in_words(3, std::numeric_limits<double>::infinity()) == "inf");
  CHECK(amount_in_words(0, std::numeric_limits<double>::quiet_NaN()) == "nan");
}
