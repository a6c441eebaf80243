#include "calib_eval/footage.hpp"

#include <functional>
#include <memory>
#include <mutex>

#include "calib/depth_onnx.hpp"
#include "calib/depth_stereo.hpp"
#include "calib/extrinsic_check.hpp"
#include "calib/quality.hpp"
#include "calib_eval/parallel.hpp"
#include "calib_eval/simulated_drive.hpp"
#include "dataset/depth_files.hpp"

namespace calib::eval {
namespace {

/// Where frames come from.
struct Source {
  Camera camera;
  RigidTransform T_camera_lidar;
  std::optional<double> baseline_m;
  bool has_stereo = false;
  std::vector<std::string> names;
  /// Frame by number; from any thread.
  std::function<Result<FramePair>(std::size_t, Colours)> frame;
  std::function<DepthMap(std::size_t)> true_depth = {};  // where it is known
};

Result<Source> open_recording(const FootageOptions& options) {
  const auto recording = [&] {
    if (options.dataset == "kitti-raw")
      return open_kitti_raw(options.root, options.camera.empty() ? "image_02" : options.camera);
    if (options.dataset == "kitti-360")
      return open_kitti_360(options.root, options.drive, options.camera.empty() ? "image_00" : options.camera);
    return open_list(options.root);
  }();
  if (!recording) return tl::unexpected(recording.error());
  Source source{recording->camera(),
                recording->T_camera_lidar(),
                recording->baseline_m(),
                recording->has_stereo(),
                {},
                [recording = *recording](std::size_t i, Colours colours) { return recording.frame(i, colours); }};
  for (std::size_t i = 0; i < recording->size(); ++i) source.names.push_back(recording->frame_name(i));
  return source;
}

Result<Source> open_simulation(const FootageOptions& options) {
  auto driven =
      SimulatedDrive::drive({options.places, options.frames, options.period_s, options.seed, options.threads});
  if (!driven) return tl::unexpected(driven.error());
  const auto drive = std::make_shared<const SimulatedDrive>(*std::move(driven));
  Source source{drive->camera,
                drive->T_camera_lidar,
                drive->baseline_m,
                true,
                {},
                [drive](std::size_t i, Colours) -> Result<FramePair> { return drive->frames[i].pair; },
                [drive](std::size_t i) { return drive->frames[i].depth; }};
  for (const SimulatedDrive::Frame& frame : drive->frames) source.names.push_back(frame.name);
  return source;
}

Result<Source> open(const FootageOptions& options) {
  return options.dataset == "sim" ? open_simulation(options) : open_recording(options);
}

/// Of frames that are read side by side; nothing where depth is not from a network.
struct Network {
  std::unique_ptr<DepthEstimator> estimator;
  std::mutex in_use;
};

/// Returns the remark of `DepthEstimator::prepare`.
Result<std::string> open(Network& network, const FootageOptions& options, const Camera& camera) {
  constexpr std::string_view prefix = "onnx:";
  if (!options.depth.starts_with(prefix)) return std::string();
  auto estimator = make_onnx_depth(options.depth.substr(prefix.size()), camera, {.threads = options.threads});
  if (!estimator) return tl::unexpected(estimator.error());
  network.estimator = *std::move(estimator);
  return network.estimator->prepare();
}

Result<DepthMap> depth_of(const FootageOptions& options, const Source& source, Network& network, std::size_t index,
                          const FramePair& pair) {
  const auto unbiased = [&]() -> Result<DepthMap> {
    if (network.estimator) {
      const std::scoped_lock lock(network.in_use);
      return network.estimator->estimate(pair);
    }
    if (options.depth == "true") return source.true_depth(index);
    if (options.depth == "stereo") {
      // One for each frame, as they keep scratch memory and frames are read side by side.
      const auto stereo = make_stereo_depth(source.camera, *source.baseline_m);
      if (!stereo) return tl::unexpected(stereo.error());
      return (*stereo)->estimate(pair);
    }
    const auto kind = parse_depth_kind(options.depth_kind);
    if (!kind) return tl::unexpected(kind.error());
    return read_depth({options.depth_dir, *kind, options.depth_scale}, source.names[index], source.camera,
                      source.baseline_m);
  };
  auto depth = unbiased();
  if (depth && options.depth_bias > 0) add_smooth_bias(*depth, options.depth_bias, options.seed);
  return depth;
}

/// A frame of the recording: read, or why it cannot be; and, where it can, why it is of no use.
struct Reading {
  Result<FramePair> pair = fail("not_read", "");
  Result<DepthMap> depth = fail("not_read", "");
  std::optional<Error> useless;
};

Reading read_frame(const FootageOptions& options, const Source& source, Network& network, std::size_t index) {
  Reading reading;
  reading.pair = source.frame(index, network.estimator ? Colours::rgb : Colours::grey);
  if (!reading.pair) return reading;
  reading.depth = depth_of(options, source, network, index, *reading.pair);
  if (!reading.depth) {
    reading.useless = reading.depth.error();
    return reading;
  }
  mask_depth(reading.pair->image, {}, *reading.depth);
  const auto features = make_features(*reading.pair, *reading.depth, source.camera, source.T_camera_lidar, {});
  if (!features) reading.useless = features.error();
  return reading;
}

}  // namespace

std::vector<std::size_t> spread_evenly(std::size_t available, std::size_t wanted) {
  const std::size_t count = std::min(available, wanted);
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < count; ++i)
    indices.push_back(count == 1 ? available / 2 : (i * (available - 1) + (count - 1) / 2) / (count - 1));
  return indices;
}

Result<Footage> Footage::read(const FootageOptions& options) {
  const auto source = open(options);
  if (!source) return tl::unexpected(source.error());
  if (options.depth == "stereo" && !source->has_stereo)
    return fail("stereo_missing", options.root.string() +
                                      " has no right images, or no baseline is known: stereo depth "
                                      "needs both; give depth files (--depth-dir) instead");
  Network network;
  auto remark = open(network, options, source->camera);
  if (!remark) return tl::unexpected(remark.error());
  const auto indices = spread_evenly(source->names.size(), static_cast<std::size_t>(options.frames));
  std::vector<Reading> readings(indices.size());
  parallel_for(indices.size(), options.threads,
               [&](std::size_t i) { readings[i] = read_frame(options, *source, network, indices[i]); });

  Footage footage{source->camera, source->T_camera_lidar, {}, {}, *std::move(remark)};
  for (std::size_t i = 0; i < indices.size(); ++i) {
    Reading& reading = readings[i];
    if (!reading.pair) return tl::unexpected(reading.pair.error());
    // Before frames are blamed for what the extrinsic does.
    if (i == 0)
      if (auto plausible = check_extrinsic(footage.camera, footage.T_camera_lidar, reading.pair->scan); !plausible)
        return tl::unexpected(plausible.error());
    const std::string& name = source->names[indices[i]];
    if (reading.useless)
      footage.left_out.push_back("frame " + name + " is left out: " + reading.useless->context);
    else
      footage.frames.push_back({name, *std::move(reading.pair), *std::move(reading.depth)});
  }
  if (footage.frames.size() < fewest_frames)
    return fail("too_few_frames", std::to_string(footage.frames.size()) + " of " + std::to_string(indices.size()) +
                                      " frames can be used, and " + std::to_string(fewest_frames) + " are needed" +
                                      (footage.left_out.empty() ? "" : "; " + footage.left_out.front()));
  return footage;
}

Result<std::vector<FeatureSet>> Footage::features(const FeatureSettings& settings, int threads) const {
  std::vector<Result<FeatureSet>> made(frames.size(), fail("not_made", ""));
  parallel_for(frames.size(), threads, [&](std::size_t i) {
    made[i] = make_features(frames[i].pair, frames[i].depth, camera, T_camera_lidar, settings);
  });
  std::vector<FeatureSet> features;
  for (auto& one : made) {
    if (!one) return tl::unexpected(one.error());
    features.push_back(*std::move(one));
  }
  return features;
}

std::vector<const FeatureSet*> pointers(const std::vector<FeatureSet>& features) {
  std::vector<const FeatureSet*> pointers;
  for (const FeatureSet& set : features) pointers.push_back(&set);
  return pointers;
}

}  // namespace calib::eval
