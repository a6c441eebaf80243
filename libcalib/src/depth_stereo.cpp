#include "calib/depth_stereo.hpp"

#include <opencv2/calib3d.hpp>

namespace calib {
namespace {

class StereoDepth final : public DepthEstimator {
 public:
  StereoDepth(const Camera& camera, double baseline_m)
      : width_(camera.width()), height_(camera.height()), focal_times_baseline_(camera.fx() * baseline_m) {
    // About a tenth of the width: nearest depth 10 f B / width, some 3 m on a car's stereo camera.
    const int disparities = std::max(16, (width_ / 10 + 15) / 16 * 16);
    constexpr int block = 5;
    matcher_ = cv::StereoSGBM::create(0, disparities, block, 8 * block * block, 32 * block * block,
                                      /*disp12MaxDiff=*/1, /*preFilterCap=*/31, /*uniquenessRatio=*/10,
                                      /*speckleWindowSize=*/100, /*speckleRange=*/2, cv::StereoSGBM::MODE_SGBM_3WAY);
  }

  Result<DepthMap> estimate(const FramePair& pair) override {
    if (!pair.right_image) return fail("depth_failed", "stereo depth needs a right image");
    for (const Image* image : {&pair.image, &*pair.right_image})
      if (image->width != width_ || image->height != height_)
        return fail("depth_failed", "an image is " + std::to_string(image->width) + " x " +
                                        std::to_string(image->height) + " where the configuration says " +
                                        std::to_string(width_) + " x " + std::to_string(height_));
    try {
      matcher_->compute(view(pair.image), view(*pair.right_image), disparity_);
    } catch (const cv::Exception& exception) {
      return fail("depth_failed", std::string("stereo matching failed: ") + exception.what());
    }
    return inverse_depth();
  }

 private:
  static cv::Mat view(const Image& image) {
    return {image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.pixels.data())};  // read only
  }

  [[nodiscard]] DepthMap inverse_depth() const {
    constexpr float pixels_per_unit = 1.0F / int{cv::StereoMatcher::DISP_SCALE};
    const float scale = pixels_per_unit / static_cast<float>(focal_times_baseline_);
    DepthMap depth{width_, height_, std::vector<float>(static_cast<std::size_t>(width_) * height_)};
    for (int v = 0; v < height_; ++v) {
      const auto* disparity = disparity_.ptr<std::int16_t>(v);
      float* out = depth.inverse_depth.data() + static_cast<std::ptrdiff_t>(v) * width_;
      // Half a pixel of disparity and less is beyond any LiDAR's range and mostly false matches.
      for (int u = 0; u < width_; ++u)
        out[u] = disparity[u] > cv::StereoMatcher::DISP_SCALE / 2 ? static_cast<float>(disparity[u]) * scale
                                                                  : DepthMap::no_depth;
    }
    return depth;
  }

  int width_, height_;
  double focal_times_baseline_;
  cv::Ptr<cv::StereoSGBM> matcher_;
  cv::Mat disparity_;
};

}  // namespace

Result<std::unique_ptr<DepthEstimator>> make_stereo_depth(const Camera& camera, double baseline_m) {
  if (!(baseline_m >= 1e-3 && baseline_m <= 10))
    return fail("bad_camera", "baseline_m is " + std::to_string(baseline_m) + "; 0.001 .. 10 m are possible");
  if (camera.model() != CameraModel::rectified)
    return fail("bad_camera", "depth source stereo needs rectified images; use model: rectified and image_rect topics");
  return std::make_unique<StereoDepth>(camera, baseline_m);
}

}  // namespace calib
