#pragma once

#include "config.hpp"
#include "dds/window.hpp"

namespace calib {

/// What is read of a pair, and which sizes its configuration allows.
[[nodiscard]] PairTopics topics_of(const PairConfig& pair);

/// The largest message that any of the topics may bring, for `Bus::open`: four bytes per pixel of an image or 64 per
/// point of a cloud, and some room for padded rows. At least 16 MiB, so that what is moderately too large is still
/// refused by its name; larger ones are lost without a word but Cyclone's.
[[nodiscard]] std::uint32_t max_sample_bytes(const Config& config);

}  // namespace calib
