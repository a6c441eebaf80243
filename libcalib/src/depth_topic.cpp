#include "calib/depth_topic.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

namespace calib {
namespace {

std::string size_text(int width, int height) { return fmt::format("{} x {}", width, height); }

class TopicDepth final : public DepthEstimator {
 public:
  TopicDepth(const Camera& camera, const std::optional<DepthCamera>& own) : camera_(camera), own_(own) {}

  Result<DepthMap> estimate(const FramePair& pair) override {
    if (!pair.depth) return fail(ErrorCode::depth_failed, "no depth came with the image");
    const DepthImage& seen = *pair.depth;
    if (seen.width < 1 || seen.height < 1 ||
        seen.inverse_depth.size() != static_cast<std::size_t>(seen.width) * seen.height)
      return fail(ErrorCode::depth_failed, "the depth image has no pixels");
    return own_ ? carried_over(seen) : registered(seen);
  }

 private:
  [[nodiscard]] Result<DepthMap> registered(const DepthImage& seen) const {
    const int width = camera_.width(), height = camera_.height();
    const double stretched = static_cast<double>(seen.width) * height / (static_cast<double>(seen.height) * width);
    if (std::abs(stretched - 1) > 0.01)
      return fail(ErrorCode::depth_failed,
                  "the depth image is " + size_text(seen.width, seen.height) +
                      ", which is no scaled picture of the camera's " + size_text(width, height) +
                      "; give the depth camera's own intrinsics (depth.camera and T_camera_depth)");
    DepthMap depth{width, height, {}};
    depth.inverse_depth.reserve(static_cast<std::size_t>(width) * height);
    for (int v = 0; v < height; ++v) {
      // The pixel in whose area the middle of this one lies.
      const std::int64_t row = (2 * std::int64_t{v} + 1) * seen.height / (2 * std::int64_t{height});
      for (int u = 0; u < width; ++u) {
        const std::int64_t column = (2 * std::int64_t{u} + 1) * seen.width / (2 * std::int64_t{width});
        depth.inverse_depth.push_back(seen.inverse_depth[row * seen.width + column]);
      }
    }
    return depth;
  }

  [[nodiscard]] Result<DepthMap> carried_over(const DepthImage& seen) {
    const Camera& own = own_->camera;
    if (seen.width != own.width() || seen.height != own.height())
      return fail(ErrorCode::depth_failed, "the depth image is " + size_text(seen.width, seen.height) +
                                               " where depth.camera says " + size_text(own.width(), own.height()));
    if (bearings_.empty()) take_bearings();
    const int width = camera_.width(), height = camera_.height();
    // A pixel of the coarser camera covers several of the finer one's.
    const int side = std::clamp(static_cast<int>(std::ceil(camera_.fx() / own.fx())), 1, 16);
    DepthMap depth{width, height, std::vector<float>(static_cast<std::size_t>(width) * height, DepthMap::no_depth)};
    for (std::size_t i = 0; i < bearings_.size(); ++i) {
      const float inverse = seen.inverse_depth[i];
      if (!(inverse > DepthMap::no_depth)) continue;
      const Eigen::Vector3d p = own_->T_camera_depth * (bearings_[i].cast<double>() / inverse);
      const auto uv = camera_.project(p);
      if (!uv || p.z() <= 0) continue;
      const auto nearer = static_cast<float>(1 / p.z());
      const int left = static_cast<int>(std::floor(uv->x() + 0.5 - 0.5 * (side - 1))),
                top = static_cast<int>(std::floor(uv->y() + 0.5 - 0.5 * (side - 1)));
      for (int v = std::max(top, 0); v < std::min(top + side, height); ++v)
        for (int u = std::max(left, 0); u < std::min(left + side, width); ++u) {
          float& there = depth.inverse_depth[static_cast<std::size_t>(v) * width + u];
          there = std::max(there, nearer);
        }
    }
    return depth;
  }

  /// Of each of the depth camera's pixels, one metre along its axis; NaN where it has none.
  void take_bearings() {
    const Camera& own = own_->camera;
    bearings_.reserve(static_cast<std::size_t>(own.width()) * own.height());
    for (int v = 0; v < own.height(); ++v)
      for (int u = 0; u < own.width(); ++u) {
        const auto bearing = own.unproject(Eigen::Vector2d(u, v));
        const bool ahead = bearing && bearing->z() > 0;
        bearings_.push_back(ahead ? Eigen::Vector3f((*bearing / bearing->z()).cast<float>())
                                  : Eigen::Vector3f::Constant(std::numeric_limits<float>::quiet_NaN()));
      }
  }

  Camera camera_;
  std::optional<DepthCamera> own_;
  std::vector<Eigen::Vector3f> bearings_;
};

}  // namespace

std::unique_ptr<DepthEstimator> make_topic_depth(const Camera& camera, const std::optional<DepthCamera>& own) {
  return std::make_unique<TopicDepth>(camera, own);
}

}  // namespace calib
