#pragma once

#include <cstdint>
#include <string>

#include "calib/camera.hpp"
#include "calib/result.hpp"

namespace calib {

inline constexpr std::int64_t max_image_pixels = 64'000'000;

struct ImageSize {
  int width = 0, height = 0;
  bool operator==(const ImageSize&) const = default;
};
[[nodiscard]] inline ImageSize size_of(const Camera& camera) { return {camera.width(), camera.height()}; }

/// The sizes that the images of a topic may have, checked against the header of an image before anything is decoded,
/// converted or allocated; and how many bits of its 16-bit values a camera fills.
class ImageBound {
 public:
  /// `scaled` and `similar` images have at most this many times the pixels of the reference size.
  static constexpr std::int64_t max_pixel_ratio = 4;

  /// Any size up to 64 Mpx.
  ImageBound() = default;
  /// Images of this size. `key` is that of the configuration, such as camera.size.
  [[nodiscard]] static ImageBound exactly(ImageSize size, std::string key);
  /// Scaled versions of images of `size`: same aspect ratio to 1 %, as `make_topic_depth` requires.
  [[nodiscard]] static ImageBound scaled(ImageSize size, std::string key);
  /// Images of unknown size that are taken together with images of `size`.
  [[nodiscard]] static ImageBound similar(ImageSize size, std::string key);

  /// Fails with `image_size_mismatch`; the message names both sizes and the key.
  [[nodiscard]] Result<void> check(ImageSize seen) const;
  [[nodiscard]] ImageBound with_significant_bits(int bits) const {
    ImageBound changed = *this;
    changed.significant_bits_ = bits;
    return changed;
  }
  /// The greatest 16-bit value is 2^this - 1.
  [[nodiscard]] int significant_bits() const { return significant_bits_; }
  /// Of the largest image that is accepted.
  [[nodiscard]] std::int64_t max_pixels() const;

 private:
  enum class Rule { any, exactly, scaled, similar };
  ImageBound(Rule rule, ImageSize size, std::string key) : rule_(rule), size_(size), key_(std::move(key)) {}

  Rule rule_ = Rule::any;
  ImageSize size_;
  std::string key_;
  int significant_bits_ = 16;
};

}  // namespace calib
