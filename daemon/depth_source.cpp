#include "depth_source.hpp"

#include <fmt/format.h>

#include <future>
#include <thread>

namespace calib {
namespace {

using std::chrono::steady_clock;

constexpr std::chrono::milliseconds poll_interval{20};  // what an end waits for at most
/// An estimator that has not returned this long after it was cancelled hangs.
constexpr std::chrono::seconds cancel_grace{10};

bool same(const CameraInfo& a, const CameraInfo& b) {
  return a.width == b.width && a.height == b.height && a.model == b.model && a.K == b.K && a.D == b.D && a.P == b.P &&
         a.R == b.R;
}

}  // namespace

void DepthSource::set_left_camera_info(const CameraInfo& info) { set(infos_.left, info); }

void DepthSource::set_right_camera_info(const CameraInfo& info) { set(infos_.right, info); }

void DepthSource::set(std::optional<CameraInfo>& known, const CameraInfo& info) {
  if (!known || !same(*known, info)) failure_.reset(), estimator_.reset();
  known = info;
}

bool DepthSource::has_cameras() const { return calib::has_cameras(pair_.depth, pair_.camera.camera, infos_); }

std::optional<ImageSize> DepthSource::right_image_size() const {
  if (!infos_.right) return std::nullopt;
  return ImageSize{infos_.right->width, infos_.right->height};
}

Result<std::string> DepthSource::prepare() {
  if (failure_) return tl::unexpected(*failure_);
  if (estimator_ || !has_cameras()) return std::string();
  const auto fails = [this](const Error& error) {
    return tl::unexpected(*(failure_ = Error{ErrorCode::depth_failed, error.context}));
  };
  auto made = make_ ? make_(pair_) : make_estimator(pair_.depth, pair_.camera.camera, infos_);
  if (!made) return fails(made.error());
  estimator_ = std::move(*made);
  auto remark = supervise<std::string>([this] { return estimator_->prepare(); });
  if (!remark && estimator_) return fails(remark.error());
  return remark;
}

Result<DepthMap> DepthSource::estimate(const FramePair& pair) {
  if (busy_) return fail(ErrorCode::depth_failed, "depth is being estimated already; ask again");
  if (const auto ready = prepare(); !ready) return propagate(ready);
  if (!estimator_)
    return fail(ErrorCode::camera_info_missing,
                "no CameraInfo told where the right camera is; is depth.right_info the right topic (and camera.info)?");
  return supervise<DepthMap>([&] { return estimator_->estimate(pair); });
}

template <typename T>
Result<T> DepthSource::supervise(const std::function<Result<T>()>& work) {
  std::packaged_task<Result<T>()> task(work);
  auto result = task.get_future();
  std::thread thread(std::move(task));
  busy_ = true;
  const auto deadline = steady_clock::now() + pair_.depth_timeout;
  std::optional<steady_clock::time_point> cancelled;
  bool ending = false;
  while (result.wait_for(poll_interval) != std::future_status::ready) {
    const auto time = steady_clock::now();
    if (!cancelled || time < *cancelled + cancel_grace) ending = !poll_() || ending;
    if (cancelled || (!ending && time < deadline)) continue;
    estimator_->cancel();
    cancelled = time;
  }
  thread.join();
  busy_ = false;
  if (!cancelled) return result.get();
  estimator_.reset();  // a cancelled estimator fails ever after
  if (ending) return fail(ErrorCode::depth_failed, "calibd ends");
  return fail(ErrorCode::depth_failed,
              fmt::format("depth took longer than {:g} s; give it more time (depth.timeout), or less "
                          "to do",
                          std::chrono::duration<double>(pair_.depth_timeout).count()));
}

}  // namespace calib
