#include <CLI/CLI.hpp>
#include <map>

#include "vehicle/play.hpp"

namespace calib::vehicle {

void add_play_options(CLI::App& app, PlayOptions& options) {
  const auto triple = [&app](const char* name, std::array<double, 3>& values, const char* text) {
    app.add_option(name, values, text)->delimiter(',')->option_text("A,B,C");
  };
  app.add_option("--rate", options.rate_hz, "frames per second")->check(CLI::Range(0.01, 100.0))->capture_default_str();
  app.add_option("--duration", options.duration_s, "end after so many seconds of driving")
      ->check(CLI::NonNegativeNumber);
  app.add_option("--frames", options.frames, "end after so many frames");
  app.add_flag("--fast", options.fast, "publish each frame as soon as it is made");

  app.add_option("--domain", options.publisher.domain, "DDS domain")->check(CLI::Range(0, 230))->capture_default_str();
  app.add_option("--interface", options.publisher.interface, "network interface")->capture_default_str();
  app.add_flag("--best-effort", options.publisher.best_effort, "publish with best-effort reliability");
  Topics& topics = options.publisher.topics;
  app.add_option("--left-image", topics.left_image, "topic")->capture_default_str();
  app.add_option("--right-image", topics.right_image, "topic")->capture_default_str();
  app.add_option("--left-info", topics.left_info, "topic")->capture_default_str();
  app.add_option("--right-info", topics.right_info, "topic")->capture_default_str();
  app.add_option("--cloud", topics.cloud, "topic")->capture_default_str();
  auto* depth = app.add_option("--depth-topic", topics.depth, "publish the left camera's true depth as well, here");
  app.add_option("--depth-as", options.publisher.depth_as, "its message")
      ->transform(CLI::CheckedTransformer(std::map<std::string, DepthAs>{
          {"32FC1", DepthAs::metres}, {"16UC1", DepthAs::millimetres}, {"disparity", DepthAs::disparity}}))
      ->needs(depth);
  auto* motion = app.add_option("--motion-topic", topics.motion, "publish how the vehicle turns as well, here");
  app.add_option("--motion-as", options.publisher.motion_as, "its message")
      ->transform(CLI::CheckedTransformer(
          std::map<std::string, MotionAs>{{"imu", MotionAs::imu}, {"odometry", MotionAs::odometry}}))
      ->needs(motion);

  triple("--knock-deg", options.knock.rotation_deg, "turn the LiDAR: roll,pitch,yaw");
  triple("--knock-cm", options.knock.translation_cm, "shift the LiDAR: x,y,z");
  triple("--drift-deg-per-minute", options.knock.drift_deg_per_minute, "turn the LiDAR slowly: roll,pitch,yaw");
  triple("--drift-cm-per-minute", options.knock.drift_cm_per_minute, "shift the LiDAR slowly: x,y,z");
  auto* after = app.add_option("--after", options.knock.start_s, "knock, or begin to drift, after so many seconds");
  after->check(CLI::NonNegativeNumber);
  app.add_option("--after-frames", options.knock_after_frames, "knock, or begin to drift, after so many frames")
      ->excludes(after);

  app.add_option("--time-offset-ms", options.time_offset_ms, "added to the cloud's stamp");
  app.add_option("--freeze-camera-after", options.freeze_camera_after_s, "repeat one image from so many seconds on");
  app.add_option("--silence-lidar-after", options.silence_lidar_after_s, "publish no cloud from so many seconds on");

  app.add_flag("--print-config", options.print_config, "print calibd's `pairs:` for this vehicle, and end");
  app.add_option("--dump", options.dump, "write the drive in KITTI's raw layout below this folder, and end");
  auto* overlay =
      app.add_option("--overlay", options.overlay, "write a picture of one frame with the LiDAR points on it, and end");
  app.add_option("--frame", options.overlay_frame, "which frame")->needs(overlay);
  app.add_option("--T-camera-lidar", options.overlay_T_camera_lidar,
                 "extrinsic to draw the points with: tx,ty,tz,qx,qy,qz,qw (default: the one before any knock)")
      ->delimiter(',')
      ->needs(overlay);
}

}  // namespace calib::vehicle
