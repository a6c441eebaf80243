#include <CLI/CLI.hpp>
#include <iostream>

#include "vehicle/camera_option.hpp"
#include "vehicle/play.hpp"
#include "vehicle/varied_place.hpp"

int main(int argc, char** argv) {
  using namespace calib;
  vehicle::Simulation simulation;
  vehicle::PlayOptions options;
  CLI::App app(
      "A simulated vehicle with a stereo camera and a LiDAR drives through a street and publishes what they "
      "see.");
  app.add_option("--seed", simulation.seed, "which street")->capture_default_str();
  app.add_option("--width", simulation.width, "of the images, pixels")
      ->check(CLI::Range(160, 4096))
      ->capture_default_str();
  app.add_option("--height", simulation.height, "of the images, pixels")
      ->check(CLI::Range(64, 4096))
      ->capture_default_str();
  std::string camera, size;
  auto* camera_option = app.add_option("--camera", camera,
                                       "for --dump: one camera of any model instead of the stereo camera: "
                                       "fisheye-double-sphere, kitti-360-fisheye or MODEL:fx,fy,cx,cy[,distortion...]");
  app.add_option("--size", size, "its size, WxH pixels")->needs(camera_option);
  app.add_flag("--dark", simulation.dark, "night: the cameras see next to nothing");
  app.add_option("--lidar-dropout", simulation.lidar.dropout, "share of returns that get lost")
      ->check(CLI::Range(0.0, 1.0))
      ->capture_default_str();
  app.add_option("--lidar-step-deg", simulation.lidar.azimuth_step_deg, "azimuth between two columns")
      ->check(CLI::Range(0.05, 5.0))
      ->capture_default_str();
  app.add_option("--lidar-fov-deg", simulation.lidar.field_of_view_deg, "azimuth covered, centred ahead")
      ->check(CLI::Range(10.0, 360.0))
      ->capture_default_str();
  double cloud_late_ms = 0, weave_deg = 0;
  app.add_option("--cloud-late-ms", cloud_late_ms, "the LiDAR measures so long after the cameras, and says so")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  app.add_option("--weave-deg", weave_deg, "the heading swings to both sides by so much, once in six seconds")
      ->check(CLI::Range(0.0, 30.0))
      ->capture_default_str();
  vehicle::add_play_options(app, options);
  app.add_flag("--unrectified", simulation.unrectified,
               "the stereo camera's images as they come: lenses that bend, mounts that are not straight")
      ->excludes(camera_option)
      ->excludes("--dump");
  bool vary = false;
  app.add_flag(
         "--vary", vary,
         "for --dump: every frame from another place, camera and light, as an image and its depth; no LiDAR. What "
         "tools/train learns from")
      ->needs("--dump")
      ->needs("--frames")
      ->excludes(camera_option);
  camera_option->needs("--dump")->excludes("--print-config")->excludes("--overlay");
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const auto usage = [](const Error& error) {
    std::cerr << to_string(error.code) << ": " << error.context << '\n';
    return 2;
  };
  if (vary) {
    const auto dumped =
        vehicle::dump_varied_views(options.dump, simulation.seed, *options.frames, simulation.width, simulation.height);
    if (dumped) return 0;
    std::cerr << to_string(dumped.error().code) << ": " << escape_control(dumped.error().context) << '\n';
    return 1;
  }
  if (!camera.empty()) {
    auto parsed = vehicle::parse_camera(camera, size);
    if (!parsed) return usage(parsed.error());
    simulation.camera = *std::move(parsed);
  }
  simulation.cloud_late_s = cloud_late_ms / 1000;
  simulation.weave_rad = weave_deg * radians_per_degree;
  const auto simulated = vehicle::simulated_vehicle(simulation);
  if (!simulated) return usage(simulated.error());
  return vehicle::play(*simulated, options);
}
