#pragma once

#include <cstdint>
#include <optional>
#include <string>

namespace calib {

/// An image whose greatest 16-bit value is `greatest`, of which `bits` are significant, may come from a camera of 10,
/// 12 or 14 bits whose values were not shifted up: then it seems to be dark. What to write if so, in words.
[[nodiscard]] std::optional<std::string> fewer_bits(std::uint32_t greatest, int bits);

}  // namespace calib
