#pragma once

#include <concepts>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <utility>

namespace calib {

/// A whole number that `Integer` can hold. Throws std::invalid_argument for anything else: nlohmann's own `get`
/// converts any number, and 1e300 to an integer is undefined.
template <std::integral Integer>
[[nodiscard]] Integer integer_from(const nlohmann::json& value) {
  const auto checked = [](auto number) {
    if (!std::in_range<Integer>(number)) throw std::invalid_argument("a whole number is out of range");
    return static_cast<Integer>(number);
  };
  if (const auto* number = value.get_ptr<const nlohmann::json::number_unsigned_t*>()) return checked(*number);
  if (const auto* number = value.get_ptr<const nlohmann::json::number_integer_t*>()) return checked(*number);
  throw std::invalid_argument("a whole number is needed");
}

}  // namespace calib
