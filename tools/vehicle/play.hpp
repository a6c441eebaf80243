#pragma once

#include <filesystem>
#include <optional>

#include "vehicle/knock.hpp"
#include "vehicle/publisher.hpp"
#include "vehicle/vehicle.hpp"

namespace CLI {
class App;
}

namespace calib::vehicle {

/// How a vehicle is driven, and what else is done with its frames. Times are drive time: frame index / rate.
struct PlayOptions {
  PublisherOptions publisher;
  double rate_hz = 2;
  std::optional<double> duration_s;
  std::optional<std::size_t> frames;
  bool fast = false;  // the next frame at once
  Knock knock;
  std::optional<std::size_t> knock_after_frames;  // instead of knock.start_s

  double time_offset_ms = 0;  // added to the cloud's stamp
  std::optional<double> freeze_camera_after_s, silence_lidar_after_s;

  bool print_config = false;
  std::filesystem::path dump, overlay;
  std::size_t overlay_frame = 0;
  std::array<double, 7> overlay_T_camera_lidar{};  // x, y, z, qx, qy, qz, qw; all zero: the vehicle's before it moves
};

/// Options that the simulated and the recorded vehicle have in common.
void add_play_options(CLI::App& app, PlayOptions& options);

/// Does what `options` ask for: drives the vehicle until its end or a SIGINT or SIGTERM, with the truth as
/// JSON lines on standard output, or prints a configuration, writes an overlay or dumps a drive. Errors go to
/// standard error. Returns the exit code.
[[nodiscard]] int play(const Vehicle& vehicle, const PlayOptions& options);

}  // namespace calib::vehicle
