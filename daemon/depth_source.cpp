#include "depth_source.hpp"

#include <fmt/format.h>
#include <malloc.h>

#include <cmath>
#include <future>
#include <thread>

#include "calib/config_node.hpp"
#include "calib/sha256.hpp"

namespace calib {
namespace {

using std::chrono::steady_clock;

constexpr std::chrono::milliseconds breath{200};
/// An estimator that does not end within this, once cancelled, hangs.
constexpr std::chrono::seconds patience{10};

Eigen::Matrix3d matrix(const std::array<double, 9>& row_major) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(row_major.data());
}

bool is_rotation(const Eigen::Matrix3d& R) {
  return (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && R.determinant() > 0;
}

bool alike(const Camera& a, const Camera& b) {
  const auto differ = [](double x, double y) { return std::abs(x - y) > 0.5; };
  return a.width() == b.width() && a.height() == b.height() && !differ(a.fx(), b.fx()) && !differ(a.fy(), b.fy()) &&
         !differ(a.cx(), b.cx()) && !differ(a.cy(), b.cy());
}

bool same(const CameraInfo& a, const CameraInfo& b) {
  return a.width == b.width && a.height == b.height && a.model == b.model && a.K == b.K && a.D == b.D && a.P == b.P &&
         a.R == b.R;
}

}  // namespace

Result<RightCamera> right_camera(const Camera& left, const std::optional<CameraInfo>& left_info,
                                 const CameraInfo& right_info) {
  const auto& P = right_info.P;
  const auto refuse = [](const std::string& what) {
    return fail(ErrorCode::bad_camera,
                "the right CameraInfo " + what + "; calibrate the stereo camera, or give right_camera");
  };
  if (!(P[0] > 1 && P[5] > 1 && P[3] < 0)) return refuse("has no baseline in P (P[3] = -fx * baseline)");
  const RigidTransform baseline(Eigen::Translation3d(P[3] / P[0], P[7] / P[5], 0));
  if (left.model() == CameraModel::rectified) {
    auto camera = Camera::make(CameraModel::rectified, right_info.width, right_info.height, {P[0], P[5], P[2], P[6]});
    if (!camera) return refuse("is of no camera: " + camera.error().context);
    // People write down fewer digits than cameras send: what is meant to be the same is.
    if (alike(left, *camera)) return rectified_right_camera(left, -baseline.translation().x());
    return RightCamera{std::move(*camera), baseline};
  }
  const auto& K = right_info.K;
  auto camera =
      Camera::make(right_info.model, right_info.width, right_info.height, {K[0], K[4], K[2], K[5]}, right_info.D);
  if (!camera) return refuse("is of no camera: " + camera.error().context);
  const Eigen::Matrix3d R_rectified_right = matrix(right_info.R),
                        R_rectified_left = left_info ? matrix(left_info->R) : Eigen::Matrix3d::Zero();
  if (!is_rotation(R_rectified_right) || !is_rotation(R_rectified_left))
    return refuse("or the left one has an R that is no rotation");
  return RightCamera{std::move(*camera),
                     RigidTransform(R_rectified_right.transpose()) * baseline * RigidTransform(R_rectified_left)};
}

std::string sha256_of_file(const std::filesystem::path& descriptor) {
  const auto text = read_config_text(descriptor);
  return text ? sha256_hex(*text) : "";
}

void DepthSource::hear_left(const CameraInfo& info) {
  if (!left_info_ || !same(*left_info_, info)) failure_.reset(), estimator_.reset();
  left_info_ = info;
}

void DepthSource::hear_right(const CameraInfo& info) {
  if (!right_info_ || !same(*right_info_, info)) failure_.reset(), estimator_.reset();
  right_info_ = info;
}

bool DepthSource::knows_cameras() const {
  const auto* stereo = std::get_if<StereoDepthConfig>(&pair_.depth);
  if (stereo == nullptr || !stereo->right_info) return true;
  return right_info_ && (left_info_ || pair_.camera.camera.model() == CameraModel::rectified);
}

std::optional<ImageSize> DepthSource::right_size() const {
  if (!right_info_) return std::nullopt;
  return ImageSize{right_info_->width, right_info_->height};
}

Result<std::unique_ptr<DepthEstimator>> DepthSource::make() const {
  const Camera& camera = pair_.camera.camera;
  if (const auto* onnx = std::get_if<OnnxDepthConfig>(&pair_.depth)) {
    // Evidence of two networks must not be taken for that of one.
    if (!onnx->descriptor_sha256.empty() && sha256_of_file(onnx->model) != onnx->descriptor_sha256)
      return fail(ErrorCode::depth_failed, onnx->model.string() + " has changed since calibd started; restart calibd");
    return make_onnx_depth(onnx->model, camera, onnx->settings);
  }
  if (const auto* topic = std::get_if<TopicDepthConfig>(&pair_.depth)) return make_topic_depth(camera, topic->camera);
  const auto& stereo = std::get<StereoDepthConfig>(pair_.depth);
  const auto right = stereo.right_camera ? *stereo.right_camera : right_camera(camera, left_info_, *right_info_);
  if (!right) return propagate(right);
  return make_stereo_depth(camera, *right, stereo.matcher);
}

Result<std::string> DepthSource::prepare() {
  if (failure_) return tl::unexpected(*failure_);
  if (estimator_ || !knows_cameras()) return std::string();
  const auto fails = [this](const Error& error) {
    return tl::unexpected(*(failure_ = Error{ErrorCode::depth_failed, error.context}));
  };
  auto made = make_ ? make_(pair_) : make();
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
  while (result.wait_for(breath) != std::future_status::ready) {
    const auto time = steady_clock::now();
    if (!cancelled || time < *cancelled + patience) ending = !breathe_() || ending;
    if (cancelled || (!ending && time < deadline)) continue;
    estimator_->cancel();
    cancelled = time;
  }
  thread.join();
  busy_ = false;
#ifdef __GLIBC__
  // What loading and running a network leave behind is free, and yet resident: several times the network itself.
  if (const auto* onnx = std::get_if<OnnxDepthConfig>(&pair_.depth); onnx && !onnx->settings.memory_arena)
    malloc_trim(0);
#endif
  if (!cancelled) return result.get();
  estimator_.reset();  // what was cancelled stays so
  if (ending) return fail(ErrorCode::depth_failed, "calibd ends");
  return fail(ErrorCode::depth_failed,
              fmt::format("depth took longer than {:g} s; give it more time (depth.timeout), or less "
                          "to do",
                          std::chrono::duration<double>(pair_.depth_timeout).count()));
}

}  // namespace calib
