#include "calib/axis_words.hpp"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "calib/geometry.hpp"

namespace calib {
namespace {

struct Sides {
  const char *positive, *negative;
};
constexpr std::array<Sides, 6> sides{{{"right side down", "left side down"},
                                      {"nose down", "nose up"},
                                      {"to the left", "to the right"},
                                      {"forward", "back"},
                                      {"to the left", "to the right"},
                                      {"up", "down"}}};

}  // namespace

std::string amount_in_words(int axis, double amount) {
  return axis < 3 ? fmt::format("{:.2f}", std::abs(amount) / radians_per_degree)
                  : fmt::format("{:.1f}", std::abs(amount) * 100);
}

std::string motion_in_words(int axis, double amount, std::optional<double> sigma) {
  std::string words = amount_in_words(axis, amount);
  const bool is_zero = words.find_first_of("123456789") == std::string::npos;
  words += axis < 3 ? " degrees" : " cm";
  const Sides& side = sides[static_cast<std::size_t>(axis)];
  if (!is_zero) words.append(" ").append(amount > 0 ? side.positive : side.negative);
  if (sigma) words += ", sigma " + amount_in_words(axis, *sigma);
  return words;
}

}  // namespace calib
