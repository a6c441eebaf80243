#include "calib/image_bits.hpp"

namespace calib {

std::optional<std::string> fewer_bits(std::uint32_t greatest, int bits) {
  for (const int fewer : {10, 12, 14})
    if (const std::uint32_t end = 1U << fewer; fewer < bits && greatest > 0 && greatest < end)
      return "its values of 16 bits stay below " + std::to_string(end) + " (the greatest is " +
             std::to_string(greatest) + "); if the camera has " + std::to_string(fewer) +
             " bits, write camera.bits: " + std::to_string(fewer);
  return std::nullopt;
}

}  // namespace calib
