#pragma once

#include <cstdint>
#include <opencv2/core.hpp>
#include <vector>

#include "calib/depth_stereo.hpp"

namespace calib {

inline constexpr double least_baseline_m = 1e-3, most_baseline_m = 10;

/// Turns a pair of cameras of any models into two pinholes that look the same way, side by side: a row of one is a row
/// of the other (Fusiello, Trucco and Verri 2000, by each lens's own projection).
class StereoRectification {
 public:
  /// Fails with `bad_camera` as `make_stereo_depth` does.
  [[nodiscard]] static Result<StereoRectification> make(const Camera& left, const RightCamera& right);

  [[nodiscard]] int width() const { return width_; }
  /// Of the rectified pinhole, times the distance between the cameras: pixels times metres.
  [[nodiscard]] double focal_times_baseline() const { return focal_ * baseline_m_; }

  [[nodiscard]] cv::Mat left(const cv::Mat& image) const { return warp(image, left_); }
  [[nodiscard]] cv::Mat right(const cv::Mat& image) const { return warp(image, right_); }

  /// Inverse depth along the axis of the left camera, for each of its pixels, from the rectified pair's disparity
  /// (CV_16S, in units of 1 / `cv::StereoMatcher::DISP_SCALE`). None where either camera shows nothing.
  void look_up(const cv::Mat& disparity, std::vector<float>& inverse_depth) const;

 private:
  /// Where a rectified pixel comes from, in the form quickest to read, and whether the camera sees it.
  struct Map {
    cv::Mat place, fraction, seen;
  };
  StereoRectification() = default;
  [[nodiscard]] static cv::Mat warp(const cv::Mat& image, const Map& map);
  [[nodiscard]] Map map_of(const Camera& camera, const Eigen::Matrix3d& R_rectified_camera) const;
  void place_left_pixels(const Camera& left, const Eigen::Matrix3d& R_rectified_left);

  int width_ = 0, height_ = 0;
  double focal_ = 0, cx_ = 0, cy_ = 0;
  double baseline_m_ = 0;
  Map left_, right_;
  /// For each pixel of the left image: its rectified pixel, -1 for none, and what turns that one's inverse depth into
  /// its own.
  struct Place {
    std::int32_t pixel = -1;
    float scale = 0;
  };
  std::vector<Place> places_;
};

}  // namespace calib
