#include "calib/depth_stereo.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <optional>

#include "stereo_rectification.hpp"

namespace calib {
namespace {

std::string size_text(int width, int height) { return fmt::format("{} x {}", width, height); }

/// Whether semi-global matching takes the images at half their size, which costs a fifth of the time. A pixel is then
/// still no wider than a beam of a LiDAR, as in `BearingGrid`.
bool is_halved(StereoMatcher kind, double focal, int width) {
  constexpr double coarsest_rad = 0.003;
  constexpr int fewest_columns = 480;
  return kind == StereoMatcher::sgbm && 2 <= coarsest_rad * focal && width / 2 >= fewest_columns;
}

cv::Ptr<cv::StereoMatcher> make_matcher(StereoMatcher kind, int width, bool halved) {
  // About a tenth of the width: nearest depth 10 f B / width, some 3 m on a car's stereo camera.
  const int disparities = std::max(16, (width / 10 + 15) / 16 * 16);
  constexpr int speckle_range = 2, left_right_pixels = 1, uniqueness_percent = 10;
  const int speckle_pixels = halved ? 50 : 100;
  if (kind == StereoMatcher::bm) {
    auto matcher = cv::StereoBM::create(disparities, /*blockSize=*/15);
    matcher->setSpeckleWindowSize(speckle_pixels);
    matcher->setSpeckleRange(speckle_range);
    matcher->setDisp12MaxDiff(left_right_pixels);
    matcher->setUniquenessRatio(uniqueness_percent);
    return matcher;
  }
  const int block = halved ? 3 : 5;
  return cv::StereoSGBM::create(0, disparities, block, 8 * block * block, 32 * block * block, left_right_pixels,
                                /*preFilterCap=*/31, uniqueness_percent, speckle_pixels, speckle_range,
                                cv::StereoSGBM::MODE_SGBM_3WAY);
}

/// Means of 2 x 2 pixels; of an odd size, without the last row or column.
cv::Mat half(const cv::Mat& image) {
  const cv::Size size(image.cols / 2, image.rows / 2);
  cv::Mat result;
  cv::resize(image(cv::Rect(0, 0, 2 * size.width, 2 * size.height)), result, size, 0, 0, cv::INTER_AREA);
  return result;
}

/// Whether the images can be matched as they come.
bool is_rectified(const Camera& left, const RightCamera& right) {
  const Camera& other = right.camera;
  const Eigen::Vector3d t = right.T_right_left.translation();
  return left.model() == CameraModel::rectified && other.model() == CameraModel::rectified &&
         left.width() == other.width() && left.height() == other.height() && left.fx() == other.fx() &&
         left.fy() == other.fy() && left.cx() == other.cx() && left.cy() == other.cy() &&
         rotation_angle_rad(right.T_right_left) < 1e-9 && t.x() < 0 && std::hypot(t.y(), t.z()) < 1e-9;
}

class StereoDepth final : public DepthEstimator {
 public:
  StereoDepth(const Camera& left, const RightCamera& right, double focal_times_baseline,
              std::optional<StereoRectification> rectification, StereoMatcher matcher)
      : left_(left),
        right_(right.camera),
        focal_times_baseline_(focal_times_baseline),
        rectification_(std::move(rectification)) {
    const int width = rectification_ ? rectification_->width() : left.width();
    halved_ = is_halved(matcher, focal_times_baseline / right.T_right_left.translation().norm(), width);
    matcher_ = make_matcher(matcher, halved_ ? width / 2 : width, halved_);
  }

  Result<DepthMap> estimate(const FramePair& pair) override {
    if (!pair.right_image) return fail(ErrorCode::depth_failed, "stereo depth needs a right image");
    for (const auto& [image, camera] : {std::pair(&pair.image, &left_), std::pair(&*pair.right_image, &right_)})
      if (image->width != camera->width() || image->height != camera->height())
        return fail(ErrorCode::depth_failed, "an image is " + size_text(image->width, image->height) +
                                                 " where the configuration says " +
                                                 size_text(camera->width(), camera->height()));
    DepthMap depth{left_.width(), left_.height(), {}};
    try {
      const cv::Mat left = view(pair.image), right = view(*pair.right_image);
      if (rectification_) {
        match(rectification_->left(left), rectification_->right(right));
        rectification_->look_up(disparity_, depth.inverse_depth);
      } else {
        match(left, right);
        depth.inverse_depth = inverse_depth();
      }
    } catch (const cv::Exception& exception) {
      return fail(ErrorCode::depth_failed, std::string("stereo matching failed: ") + exception.what());
    }
    return depth;
  }

 private:
  static cv::Mat view(const Image& image) {
    return {image.height, image.width, CV_8UC1, const_cast<std::uint8_t*>(image.pixels.data())};  // read only
  }

  void match(const cv::Mat& left, const cv::Mat& right) {
    if (!halved_) {
      matcher_->compute(left, right, disparity_);
      return;
    }
    cv::Mat found;
    matcher_->compute(half(left), half(right), found);
    disparity_.create(left.size(), CV_16S);
    for (int v = 0; v < disparity_.rows; ++v) {
      const auto* const from = found.ptr<std::int16_t>(std::min(v / 2, found.rows - 1));
      auto* const to = disparity_.ptr<std::int16_t>(v);
      for (int u = 0; u < disparity_.cols; ++u)
        to[u] = static_cast<std::int16_t>(2 * from[std::min(u / 2, found.cols - 1)]);
    }
  }

  [[nodiscard]] std::vector<float> inverse_depth() const {
    constexpr float pixels_per_unit = 1.0F / int{cv::StereoMatcher::DISP_SCALE};
    const float scale = pixels_per_unit / static_cast<float>(focal_times_baseline_);
    std::vector<float> inverse;
    inverse.reserve(disparity_.total());
    // Half a pixel of disparity and less is beyond any LiDAR's range and mostly false matches.
    for (int v = 0; v < disparity_.rows; ++v)
      for (int u = 0; u < disparity_.cols; ++u) {
        const int found = disparity_.at<std::int16_t>(v, u);
        inverse.push_back(found > cv::StereoMatcher::DISP_SCALE / 2 ? static_cast<float>(found) * scale
                                                                    : DepthMap::no_depth);
      }
    return inverse;
  }

  Camera left_, right_;
  double focal_times_baseline_;
  std::optional<StereoRectification> rectification_;
  bool halved_ = false;
  cv::Ptr<cv::StereoMatcher> matcher_;
  cv::Mat disparity_;  // of the whole images, in units of 1 / cv::StereoMatcher::DISP_SCALE
};

}  // namespace

Result<std::unique_ptr<DepthEstimator>> make_stereo_depth(const Camera& left, const RightCamera& right,
                                                          StereoMatcher matcher) {
  try {
    if (const double baseline_m = -right.T_right_left.translation().x();
        is_rectified(left, right) && baseline_m >= least_baseline_m && baseline_m <= most_baseline_m)
      return std::make_unique<StereoDepth>(left, right, left.fx() * baseline_m, std::nullopt, matcher);
    auto rectification = StereoRectification::make(left, right);
    if (!rectification) return propagate(rectification);
    const double focal_times_baseline = rectification->focal_times_baseline();
    return std::make_unique<StereoDepth>(left, right, focal_times_baseline, std::move(*rectification), matcher);
  } catch (const cv::Exception& exception) {
    return fail(ErrorCode::bad_camera, std::string("the cameras cannot be made a stereo pair: ") + exception.what());
  }
}

Result<std::unique_ptr<DepthEstimator>> make_stereo_depth(const Camera& camera, double baseline_m) {
  if (camera.model() != CameraModel::rectified)
    return fail(ErrorCode::bad_camera,
                "a baseline alone is for rectified images; use model: rectified and image_rect topics");
  return make_stereo_depth(camera, rectified_right_camera(camera, baseline_m));
}

}  // namespace calib
