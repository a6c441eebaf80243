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

/// The sizes that a topic's images may have. Asked with what an image's header says, before anything of the image is
/// decoded, converted or allocated.
class ImageBound {
 public:
  /// What is not told a size more exactly has at most so many times the pixels of what it is compared with.
  static constexpr std::int64_t most_times = 4;

  /// Any size up to 64 Mpx.
  ImageBound() = default;
  /// `key` is where the configuration says so, such as camera.size.
  [[nodiscard]] static ImageBound exactly(ImageSize size, std::string key);
  /// Images that show what those of `size` show: their sides' ratio is the same to 1 %, as libcalib's depth asks.
  [[nodiscard]] static ImageBound scaled(ImageSize size, std::string key);
  /// Images of which no more is known than that they belong to those of `size`.
  [[nodiscard]] static ImageBound similar(ImageSize size, std::string key);

  /// Fails with `image_size_mismatch`, which names both sizes and the key.
  [[nodiscard]] Result<void> check(ImageSize seen) const;
  /// Of the largest image that is taken.
  [[nodiscard]] std::int64_t max_pixels() const;

 private:
  enum class Rule { any, exactly, scaled, similar };
  ImageBound(Rule rule, ImageSize size, std::string key) : rule_(rule), size_(size), key_(std::move(key)) {}

  Rule rule_ = Rule::any;
  ImageSize size_;
  std::string key_;
};

}  // namespace calib
