#include <CLI/CLI.hpp>
#include <algorithm>
#include <iostream>

#include "vehicle/play.hpp"

int main(int argc, char** argv) {
  using namespace calib;
  std::filesystem::path folder;
  bool loop = false;
  vehicle::PlayOptions options;
  CLI::App app("Publishes a recorded KITTI raw drive as the vehicle did, with its LiDAR knocked where asked.");
  app.add_option("DRIVE", folder, "folder <date>/<drive>, its calibration files above it")->required();
  app.add_flag("--loop", loop, "begin again after the last frame, until --frames, --duration or a signal");
  vehicle::add_play_options(app, options);
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const auto drive = open_kitti_raw(folder);
  const auto recorded = drive.and_then(vehicle::recorded_vehicle);
  if (!recorded) {
    std::cerr << to_string(recorded.error().code) << ": " << escape_control(recorded.error().context) << '\n';
    return recorded.error().code == ErrorCode::recording_not_found ? 3 : 1;
  }
  if (!loop) options.frames = std::min(options.frames.value_or(drive->size()), drive->size());
  return vehicle::play(*recorded, options);
}
