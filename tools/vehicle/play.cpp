#include "vehicle/play.hpp"

#include <signal.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <functional>
#include <iostream>
#include <nlohmann/json.hpp>

#include "calib/overlay.hpp"
#include "dataset/kitti_raw_writer.hpp"
#include "dataset/list_writer.hpp"

namespace calib::vehicle {
namespace {

using Clock = std::chrono::steady_clock;
using nlohmann::json;

/// Holds back SIGINT and SIGTERM for the whole process (threads made later inherit that), to be waited for.
class EndSignals {
 public:
  EndSignals() {
    sigemptyset(&set_);
    sigaddset(&set_, SIGINT);
    sigaddset(&set_, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &set_, nullptr);
  }
  /// Waits until `time`; whether a signal came before that.
  [[nodiscard]] bool arrived_before(Clock::time_point time) const {
    while (true) {
      const auto left = std::max(Clock::duration::zero(), time - Clock::now());
      const auto seconds = std::chrono::duration_cast<std::chrono::seconds>(left);
      const timespec timeout{seconds.count(), std::chrono::nanoseconds(left - seconds).count()};
      if (sigtimedwait(&set_, nullptr, &timeout) > 0) return true;
      if (errno != EINTR) return false;
    }
  }

 private:
  sigset_t set_;
};

json to_json(const RigidTransform& transform) {
  return {{"translation_m", translation_m(transform)}, {"quaternion_xyzw", quaternion_xyzw(transform)}};
}

/// Prints the truth whenever it has changed; during slow drift once a second.
class TruthPrinter {
 public:
  explicit TruthPrinter(const RigidTransform& T_camera_lidar) : T_camera_lidar_(T_camera_lidar) {}

  void at(double t_s, std::size_t frame, const Vector6& delta) {
    const bool changed = !printed_ || delta != *printed_;
    if (!changed || (printed_ && !printed_->isZero() && t_s < printed_at_s_ + 1)) return;
    print("truth", t_s, frame, delta);
    printed_ = delta;
    printed_at_s_ = t_s;
  }
  void end(double t_s, std::size_t frame, const Vector6& delta) const { print("end", t_s, frame, delta); }

 private:
  void print(const char* event, double t_s, std::size_t frame, const Vector6& delta) const {
    const Eigen::Vector3d deg = delta.head<3>() / radians_per_degree, cm = delta.tail<3>() * 100;
    const json line{{"event", event},
                    {"t_s", t_s},
                    {"frame", frame},
                    {"T_camera_lidar", to_json(T_camera_lidar_ * perturbation(delta))},
                    {"knock_deg", {deg.x(), deg.y(), deg.z()}},
                    {"knock_cm", {cm.x(), cm.y(), cm.z()}}};
    std::cout << line.dump() << std::endl;
  }

  RigidTransform T_camera_lidar_;
  std::optional<Vector6> printed_;
  double printed_at_s_ = 0;
};

std::string depth_config(const Vehicle& vehicle, const PublisherOptions& publisher) {
  const Topics& topics = publisher.topics;
  if (!topics.depth.empty())
    return std::string("{source: topic, ") + (publisher.depth_as == DepthAs::disparity ? "disparity: " : "image: ") +
           topics.depth + "}";
  if (vehicle.baseline_m == 0) return "{source: onnx, model: /usr/share/calibd/models/street-small.yaml}";
  const bool rectified = vehicle.camera.model() == CameraModel::rectified;
  return "{source: stereo, right_image: " + topics.right_image +
         (rectified ? ", baseline_m: " + json(vehicle.baseline_m).dump() : ", right_info: " + topics.right_info) + "}";
}

std::string motion_config(const PublisherOptions& publisher) {
  if (publisher.topics.motion.empty()) return "";
  return "    motion: {topic: " + publisher.topics.motion +
         ", type: " + (publisher.motion_as == MotionAs::imu ? "imu" : "odometry") + "}\n";
}

void print_config(const Vehicle& vehicle, const PublisherOptions& publisher) {
  const Camera& camera = vehicle.camera;
  const Topics& topics = publisher.topics;
  const bool rectified = camera.model() == CameraModel::rectified;
  const std::string lens =
      rectified ? "" : ", distortion: " + json(camera.distortion()).dump() + ", info: " + topics.left_info;
  const json intrinsics{camera.fx(), camera.fy(), camera.cx(), camera.cy()};
  std::cout << "pairs:\n  - name: front\n    camera: {image: " << topics.left_image
            << ", model: " << to_string(camera.model()) << ", size: [" << camera.width() << ", " << camera.height()
            << "], intrinsics: " << intrinsics.dump() << lens << "}\n    lidar: {cloud: " << topics.cloud
            << "}\n    T_camera_lidar: {translation_m: " << json(translation_m(vehicle.T_camera_lidar)).dump()
            << ", quaternion_xyzw: " << json(quaternion_xyzw(vehicle.T_camera_lidar)).dump()
            << "}\n    depth: " << depth_config(vehicle, publisher) << '\n'
            << motion_config(publisher)
            << "    recalibration: {mode: apply, frames: 25, max_rotation_deg: 5, max_translation_cm: 50, "
               "min_interval: 5s}\n";
}

std::size_t frame_count(const PlayOptions& options) {
  std::size_t count = options.frames.value_or(SIZE_MAX);
  if (options.duration_s)
    count = std::min(count, static_cast<std::size_t>(std::ceil(*options.duration_s * options.rate_hz)));
  return count;
}

Result<void> write_overlay_of(const Vehicle& vehicle, const PlayOptions& options, const Knock& knock) {
  RigidTransform T_camera_lidar = vehicle.T_camera_lidar;
  if (const auto& v = options.overlay_T_camera_lidar; v != decltype(options.overlay_T_camera_lidar){}) {
    const auto given = make_transform({v[0], v[1], v[2]}, {v[3], v[4], v[5], v[6]});
    if (!given) return propagate(given);
    T_camera_lidar = *given;
  }
  const double t_s = static_cast<double>(options.overlay_frame) / options.rate_hz;
  const auto pair = vehicle.frame(options.overlay_frame, t_s, perturbation(knock.at(t_s)));
  if (!pair) return propagate(pair);
  return write_overlay(options.overlay, *pair, vehicle.camera, T_camera_lidar);
}

/// Makes every frame and has `write` write it.
Result<void> write_frames(const Vehicle& vehicle, const PlayOptions& options, const Knock& knock,
                          const std::function<Result<void>(const SeenFrame&)>& write) {
  TruthPrinter truth(vehicle.T_camera_lidar);
  for (std::size_t i = 0; i < frame_count(options); ++i) {
    const double t_s = static_cast<double>(i) / options.rate_hz;
    const Vector6 delta = knock.at(t_s);
    truth.at(t_s, i, delta);
    const auto seen = vehicle.frame(i, t_s, perturbation(delta));
    if (!seen) return propagate(seen);
    if (const auto written = write(*seen); !written) return written;
  }
  return {};
}

Result<void> dump(const Vehicle& vehicle, const PlayOptions& options, const Knock& knock) {
  if (!options.frames && !options.duration_s) return fail(ErrorCode::no_end, "--dump needs --frames or --duration");
  if (vehicle.baseline_m == 0) {  // no stereo camera, and KITTI's layout has room for nothing else
    auto writer = ListWriter::create(options.dump, vehicle.camera, vehicle.T_camera_lidar);
    if (!writer) return propagate(writer);
    const auto written = write_frames(vehicle, options, knock, [&](const SeenFrame& seen) {
      return writer->append(seen.image, seen.scan, seen.range_m);
    });
    if (!written) return written;
    std::cout << json{{"event", "dump"},
                      {"recording", (options.dump / "recording.yaml").string()},
                      {"depth", (options.dump / "depth").string()}}
                     .dump()
              << std::endl;
    return {};
  }
  const auto drive = options.dump / "2026_01_01" / "2026_01_01_drive_0001_sync";
  auto writer = KittiRawWriter::create(drive, vehicle.camera, vehicle.baseline_m, vehicle.T_camera_lidar);
  if (!writer) return propagate(writer);
  const auto written =
      write_frames(vehicle, options, knock, [&](const SeenFrame& seen) { return writer->append(seen); });
  if (!written) return written;
  std::cout << json{{"event", "dump"}, {"drive", drive.string()}}.dump() << std::endl;
  return {};
}

Timestamp wall_time() { return std::chrono::system_clock::now().time_since_epoch(); }

/// Publishes the turn rate, where that is asked for: at given moments, and a hundred times a second while it waits.
class MotionTeller {
 public:
  MotionTeller(const Vehicle& vehicle, Publisher& publisher, bool wanted)
      : vehicle_(vehicle), publisher_(publisher), wanted_(wanted) {}

  /// At `stamp` the vehicle has driven for `t_s`.
  void publish(Timestamp stamp, double t_s) {
    stamp_ = stamp, t_s_ = t_s;
    if (wanted_ && sent_) sent_ = publisher_.publish_motion(stamp, vehicle_.angular_velocity(t_s));
  }
  /// Waits until `time`; whether a signal, or a failure to publish, came before that.
  [[nodiscard]] bool ended_before(Clock::time_point time, const EndSignals& end_signals) {
    while (sent_) {
      const auto next = wanted_ ? std::min(time, Clock::now() + std::chrono::milliseconds(10)) : time;
      if (end_signals.arrived_before(next)) return true;
      if (next == time) return false;
      const Timestamp now = wall_time();
      publish(now, t_s_ + std::chrono::duration<double>(now - stamp_).count());
    }
    return true;
  }
  [[nodiscard]] const Result<void>& sent() const { return sent_; }

 private:
  const Vehicle& vehicle_;
  Publisher& publisher_;
  bool wanted_;
  Result<void> sent_;
  Timestamp stamp_ = wall_time();
  double t_s_ = 0;
};

std::chrono::nanoseconds nanoseconds(double seconds) { return std::chrono::nanoseconds(std::llround(1e9 * seconds)); }

Result<void> drive(const Vehicle& vehicle, const PlayOptions& options, const Knock& knock) {
  const EndSignals end_signals;
  const bool tells_motion = !options.publisher.topics.motion.empty();
  if (tells_motion && !vehicle.angular_velocity)
    return fail(ErrorCode::no_motion,
                "a recorded drive does not know how the vehicle turned; leave out --motion-topic");
  auto publisher = Publisher::open(options.publisher, vehicle);
  if (!publisher) return propagate(publisher);

  TruthPrinter truth(vehicle.T_camera_lidar);
  MotionTeller motion(vehicle, *publisher, tells_motion);
  const auto period = nanoseconds(1 / options.rate_hz), late = nanoseconds(vehicle.cloud_late_s);
  const std::size_t count = frame_count(options);
  const auto reached = [](const std::optional<double>& after_s, double t_s) { return after_s && t_s >= *after_s; };
  std::optional<FramePair> frozen;
  auto due = Clock::now();
  double t_s = 0;
  std::size_t i = 0;
  for (; i < count; ++i) {
    t_s = static_cast<double>(i) / options.rate_hz;
    const Vector6 delta = knock.at(t_s);
    auto pair = vehicle.frame(i, t_s, perturbation(delta));
    if (!pair) return propagate(pair);
    if (reached(options.freeze_camera_after_s, t_s)) {
      if (!frozen) frozen = FramePair{pair->image, pair->right_image, {}};
      pair->image = frozen->image, pair->right_image = frozen->right_image;
    }
    if (motion.ended_before(options.fast ? Clock::now() : due, end_signals)) break;
    // Behind schedule: go on from here instead of catching up in a burst.
    due = std::max(due, Clock::now() - period) + period;

    truth.at(t_s, i, delta);
    const Timestamp now = wall_time();
    const auto apart = pair->time_difference();  // as recorded; none where stamps are not set
    pair->image.stamp = now;
    if (pair->right_image) pair->right_image->stamp = now;
    pair->scan.stamp = now + apart + late + nanoseconds(1e-3 * options.time_offset_ms);
    motion.publish(now, t_s);
    if (const auto sent = publisher->publish(pair->image, pair->right_image); !sent) return sent;
    if (const auto sent = publisher->publish_depth(now, pair->depth_m); !sent) return sent;
    if (reached(options.silence_lidar_after_s, t_s)) continue;
    if (motion.ended_before(Clock::now() + late, end_signals)) break;
    motion.publish(now + late, t_s + vehicle.cloud_late_s);
    if (const auto sent = publisher->publish(pair->scan); !sent) return sent;
  }
  truth.end(t_s, i, knock.at(t_s));
  return motion.sent();
}

}  // namespace

int play(const Vehicle& vehicle, const PlayOptions& options) {
  Knock knock = options.knock;
  if (options.knock_after_frames) knock.start_s = static_cast<double>(*options.knock_after_frames) / options.rate_hz;
  Result<void> result;
  if (options.print_config)
    print_config(vehicle, options.publisher);
  else if (!options.overlay.empty())
    result = write_overlay_of(vehicle, options, knock);
  else if (!options.dump.empty())
    result = dump(vehicle, options, knock);
  else
    result = drive(vehicle, options, knock);
  if (result) return 0;
  std::cerr << to_string(result.error().code) << ": " << escape_control(result.error().context) << '\n';
  return 1;
}

}  // namespace calib::vehicle
