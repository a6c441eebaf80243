#pragma once

#include "config.hpp"
#include "dds/window.hpp"

namespace calib {

/// The topics that are read for a pair, and the sizes that its configuration allows.
[[nodiscard]] PairTopics topics_of(const PairConfig& pair);

/// The largest message that any topic of the configuration may bring, for `Bus::open`: six bytes per pixel of an image
/// or 64 per point of a cloud, and 4 MiB for padding. At least 16 MiB, so that a message that is moderately too large
/// is received and refused with a reason. Cyclone drops larger ones.
[[nodiscard]] std::uint32_t max_sample_bytes(const Config& config);

}  // namespace calib
