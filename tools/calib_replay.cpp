#include <CLI/CLI.hpp>
#include <algorithm>
#include <iostream>

#include "dataset/bag_arguments.hpp"
#include "dataset/rosbag2.hpp"
#include "vehicle/play.hpp"

int main(int argc, char** argv) {
  using namespace calib;
  std::filesystem::path folder;
  std::string dataset = "kitti-raw";
  bool loop = false;
  BagOptions bag;
  vehicle::PlayOptions options;
  CLI::App app("Publishes a recorded drive as the vehicle did, with its LiDAR knocked where asked.");
  app.add_option("DRIVE", folder,
                 "kitti-raw: folder <date>/<drive>, its calibration files above it; rosbag2: folder or file")
      ->required();
  app.add_option("--dataset", dataset, "layout of the drive")
      ->check(CLI::IsMember({"kitti-raw", "rosbag2"}))
      ->capture_default_str();
  app.add_flag("--loop", loop, "begin again after the last frame, until --frames, --duration or a signal");
  add_bag_options(app, bag);
  vehicle::add_play_options(app, options);
  app.final_callback([&] {
    bag.takes_right_image = true;
    bag.needs_depth = !options.publisher.topics.depth.empty();
    if (const std::string given = given_bag_option(app); dataset != "rosbag2" && !given.empty())
      throw CLI::ValidationError(given, "is for --dataset rosbag2");
  });
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  const bool is_bag = dataset == "rosbag2";
  const auto drive = is_bag ? open_rosbag2(folder, bag) : open_kitti_raw(folder);
  const auto recorded =
      drive.and_then([&](const Recording& recording) { return vehicle::recorded_vehicle(recording, !is_bag); });
  if (!recorded) {
    std::cerr << to_string(recorded.error().code) << ": " << escape_control(recorded.error().context) << '\n';
    return recorded.error().code == ErrorCode::recording_not_found ? 3 : 1;
  }
  for (const std::string& remark : drive->remarks()) std::cerr << "calib-replay: " << escape_control(remark) << '\n';
  if (!loop) options.frames = std::min(options.frames.value_or(drive->size()), drive->size());
  return vehicle::play(*recorded, options);
}
