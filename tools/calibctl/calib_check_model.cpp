#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <iostream>
#include <nlohmann/json.hpp>

#include "commands.hpp"
#include "dataset/cloud_file.hpp"
#include "dataset/image_file.hpp"
#include "dataset/recording.hpp"
#include "network_report.hpp"
#include "text.hpp"
#include "vehicle/camera_option.hpp"

namespace calib::ctl {
namespace {

struct NetworkOptions {
  std::filesystem::path descriptor, image, cloud, recording;
  std::string camera;
  std::vector<double> T_camera_lidar;
  std::size_t frame = 0;
  int runs = 5, threads = 1;
  bool json = false;
};

Exit exit_of(const Error& error) {
  switch (error.code) {
    case ErrorCode::config_not_found:
    case ErrorCode::recording_not_found:
    case ErrorCode::frame_out_of_range:
      return Exit::not_found;
    case ErrorCode::bad_camera:
    case ErrorCode::bad_transform:
      return Exit::usage;
    default:
      return Exit::failed;
  }
}

/// A field of view of 65 degrees, where nothing is known.
Result<Camera> guessed_camera(int width, int height) {
  const double focal_px = std::max(2.0, 0.78 * width);
  return Camera::make(CameraModel::rectified, width, height,
                      {focal_px, focal_px, (width - 1) / 2.0, (height - 1) / 2.0});
}

Result<NetworkFrame> frame_of_image(const std::filesystem::path& image, const NetworkOptions& options) {
  auto read = read_image(image, Colours::rgb);
  if (!read) return propagate(read);
  const auto size = std::to_string(read->width) + "x" + std::to_string(read->height);
  auto camera =
      options.camera.empty() ? guessed_camera(read->width, read->height) : vehicle::parse_camera(options.camera, size);
  if (!camera) return propagate(camera);
  NetworkFrame frame{.name = image.string(),
                     .pair = {*std::move(read), {}, {}},
                     .camera = *std::move(camera),
                     .camera_is_known = !options.camera.empty(),
                     .T_camera_lidar = {}};
  if (options.cloud.empty()) return frame;
  auto scan = read_cloud(options.cloud);
  if (!scan) return propagate(scan);
  frame.pair.scan = *std::move(scan);
  std::array<double, 3> translation_m{};
  std::array<double, 4> quaternion{};
  std::copy_n(options.T_camera_lidar.begin(), 3, translation_m.begin());
  std::copy_n(options.T_camera_lidar.begin() + 3, 4, quaternion.begin());
  const auto T_camera_lidar = make_transform(translation_m, quaternion);
  if (!T_camera_lidar) return propagate(T_camera_lidar);
  frame.T_camera_lidar = *T_camera_lidar;
  return frame;
}

Result<NetworkFrame> frame_of_recording(const NetworkOptions& options) {
  std::error_code ignored;
  const bool folder = std::filesystem::is_directory(options.recording, ignored);
  const auto recording = folder ? open_kitti_raw(options.recording) : open_list(options.recording);
  if (!recording) return propagate(recording);
  auto pair = recording->frame(options.frame, Colours::rgb);
  if (!pair) return propagate(pair);
  return NetworkFrame{.name = options.recording.string() + ", " + recording->frame_name(options.frame),
                      .pair = *std::move(pair),
                      .camera = recording->camera(),
                      .camera_is_known = true,
                      .T_camera_lidar = recording->T_camera_lidar()};
}

/// The golden image where nothing else is given.
Result<NetworkFrame> frame_of(const NetworkOptions& options, const DepthModel& model) {
  if (!options.recording.empty()) return frame_of_recording(options);
  if (!options.image.empty()) return frame_of_image(options.image, options);
  if (!model.golden)
    return fail(ErrorCode::image_unreadable,
                model.descriptor.string() + " names no golden pair to run the network on; give --image or --recording");
  auto frame = frame_of_image(model.golden->image, options);
  if (frame) frame->shows_a_road = false;
  return frame;
}

Exit check(const NetworkOptions& options) {
  const auto refused = [](const Error& error) {
    std::cerr << "calibctl: " << escape_control(error.context) << '\n';
    return exit_of(error);
  };
  const auto model = load_depth_model(options.descriptor);
  if (!model) return refused(model.error());
  const auto frame = frame_of(options, *model);
  if (!frame) return refused(frame.error());
  const auto report = check_network(*model, *frame, options.runs, {.threads = options.threads});
  if (!report) return refused(report.error());
  std::cout << (options.json ? json_text(report_json(*report, *frame), 2) : report_text(*report, *frame));
  return report->suspicions.empty() ? Exit::done : Exit::no;
}

}  // namespace
}  // namespace calib::ctl

int main(int argc, char** argv) {
  using calib::ctl::Exit;
  CLI::App app{"Check a depth network against its descriptor and on a frame", "calibctl check-model"};
  calib::ctl::NetworkOptions options;
  app.add_option("FILE", options.descriptor, "Descriptor of the network: calibd-model(5)")->required();
  auto* const image = app.add_option("--image", options.image, "Run it on this image; default: the golden image");
  auto* const camera =
      app.add_option("--camera", options.camera, "MODEL:fx,fy,cx,cy[,distortion...] of that image")->needs(image);
  auto* const cloud = app.add_option("--cloud", options.cloud, "Compare with this LiDAR scan (.bin, .pcd)")
                          ->needs(image)
                          ->needs(camera);
  auto* const extrinsic = app.add_option("--T-camera-lidar", options.T_camera_lidar, "TX,TY,TZ,QX,QY,QZ,QW")
                              ->delimiter(',')
                              ->expected(7)
                              ->needs(cloud);
  cloud->needs(extrinsic);
  auto* const recording =
      app.add_option(
             "--recording", options.recording,
             "Run it on a frame of a recording, with its cloud and calibration: DATE/DRIVE of KITTI raw, or the "
             "YAML file of a list")
          ->excludes(image);
  app.add_option("--frame", options.frame, "Number of that frame")->needs(recording)->capture_default_str();
  app.add_option("--runs", options.runs, "Measure the time of so many runs")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  app.add_option("--threads", options.threads, "Threads of a run")->check(CLI::Range(1, 64))->capture_default_str();
  app.add_flag("--json", options.json, "Print JSON");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : static_cast<int>(Exit::usage);
  }
  const Exit exit = calib::ctl::check(options);
  std::cout << std::flush;
  return static_cast<int>(std::cout ? exit : Exit::failed);
}
