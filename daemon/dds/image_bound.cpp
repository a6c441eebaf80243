#include "dds/image_bound.hpp"

#include <algorithm>
#include <cmath>
#include <utility>

namespace calib {
namespace {

std::int64_t pixels(ImageSize size) { return std::int64_t{size.width} * size.height; }

std::string words(ImageSize size) { return std::to_string(size.width) + " x " + std::to_string(size.height); }

}  // namespace

ImageBound ImageBound::exactly(ImageSize size, std::string key) { return {Rule::exactly, size, std::move(key)}; }
ImageBound ImageBound::scaled(ImageSize size, std::string key) { return {Rule::scaled, size, std::move(key)}; }
ImageBound ImageBound::similar(ImageSize size, std::string key) { return {Rule::similar, size, std::move(key)}; }

std::int64_t ImageBound::max_pixels() const {
  const std::int64_t most = rule_ == Rule::any       ? max_image_pixels
                            : rule_ == Rule::exactly ? pixels(size_)
                                                     : max_pixel_ratio * pixels(size_);
  return std::min(most, max_image_pixels);
}

Result<void> ImageBound::check(ImageSize seen) const {
  const auto refuse = [&](const std::string& why) {
    return fail(ErrorCode::image_size_mismatch, "the image is " + words(seen) + ", " + why);
  };
  if (rule_ == Rule::exactly && seen != size_) return refuse("and " + key_ + " is " + words(size_));
  if (pixels(seen) > max_pixels())
    return refuse("more than " + std::to_string(max_pixel_ratio) + " times the pixels of " + words(size_) + " (" +
                  key_ + ")");
  if (rule_ == Rule::scaled) {
    const double ratio =
        static_cast<double>(seen.width) * size_.height / (static_cast<double>(seen.height) * size_.width);
    if (std::abs(ratio - 1) > 0.01)
      return refuse("which does not have the aspect ratio of the camera's " + words(size_) + " (" + key_ +
                    "); give the depth camera's own intrinsics (depth.camera and T_camera_depth)");
  }
  return {};
}

}  // namespace calib
