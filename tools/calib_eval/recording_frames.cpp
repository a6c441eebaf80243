#include "calib_eval/recording_frames.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <memory>
#include <mutex>
#include <utility>

#include "calib/depth_onnx.hpp"
#include "calib/depth_stereo.hpp"
#include "calib/depth_topic.hpp"
#include "calib/extrinsic_check.hpp"
#include "calib/quality.hpp"
#include "calib_eval/parallel.hpp"
#include "calib_eval/simulated_drive.hpp"
#include "dataset/depth_files.hpp"
#include "dataset/rosbag2.hpp"

namespace calib::eval {
namespace {

/// Where frames come from.
struct Source {
  Camera camera;
  RigidTransform T_camera_lidar;
  std::optional<double> baseline_m;
  bool has_stereo = false;
  std::vector<std::string> names;
  std::vector<std::string> lacks;  // of frames that are incomplete
  /// Frame by number; from any thread.
  std::function<Result<FramePair>(std::size_t, Colours)> frame;
  std::function<DepthMap(std::size_t)> true_depth = {};  // where it is known
  std::optional<RightCamera> right_camera = {};          // where the baseline does not tell it
  std::optional<DepthCamera> depth_camera = {};          // of depth in messages, where it is another one
  std::vector<std::string> remarks = {};
};

Result<Recording> open_bag(const RecordingOptions& options) {
  BagOptions bag = options.bag;
  bag.needs_right_image = options.depth == "stereo";
  bag.needs_depth = options.depth == "topic";
  return open_rosbag2(options.root, bag);
}

Result<Source> open_recording(const RecordingOptions& options) {
  auto recording = [&] {
    if (options.dataset == "kitti-raw")
      return open_kitti_raw(options.root, options.camera.empty() ? "image_02" : options.camera);
    if (options.dataset == "kitti-360")
      return open_kitti_360(options.root, options.drive, options.camera.empty() ? "image_00" : options.camera);
    if (options.dataset == "kitti-object")
      return open_kitti_object(options.root, options.camera.empty() ? "image_2" : options.camera);
    if (options.dataset == "nuscenes")
      return open_nuscenes(options.root, options.camera.empty() ? "CAM_FRONT" : options.camera, options.drive);
    if (options.dataset == "rosbag2") return open_bag(options);
    return open_list(options.root);
  }();
  if (!recording) return propagate(recording);
  if (!options.cloud_layout.empty()) {
    const auto layout = parse_cloud_layout(options.cloud_layout);
    if (!layout) return propagate(layout);
    recording->set_cloud_layout(*layout);
  }
  Source source{recording->camera(),
                recording->T_camera_lidar(),
                recording->baseline_m(),
                recording->has_stereo(),
                {},
                recording->lacks(),
                [recording = *recording](std::size_t i, Colours colours) { return recording.frame(i, colours); }};
  for (std::size_t i = 0; i < recording->size(); ++i) source.names.push_back(recording->frame_name(i));
  source.right_camera = recording->right_camera();
  source.depth_camera = recording->depth_camera();
  source.remarks = recording->remarks();
  return source;
}

Result<Source> open_simulation(const RecordingOptions& options) {
  auto driven =
      SimulatedDrive::drive({options.places, options.frames, options.period_s, options.seed, options.threads});
  if (!driven) return propagate(driven);
  const auto drive = std::make_shared<const SimulatedDrive>(*std::move(driven));
  Source source{drive->camera,
                drive->T_camera_lidar,
                drive->baseline_m,
                true,
                {},
                {},
                [drive](std::size_t i, Colours) -> Result<FramePair> { return drive->frames[i].pair; },
                [drive](std::size_t i) { return drive->frames[i].depth; }};
  for (const SimulatedDrive::Frame& frame : drive->frames) source.names.push_back(frame.name);
  return source;
}

Result<Source> open(const RecordingOptions& options) {
  return options.dataset == "sim" ? open_simulation(options) : open_recording(options);
}

/// Of frames that are read side by side; nothing where depth is not from a network.
struct Network {
  std::unique_ptr<DepthEstimator> estimator;
  std::mutex in_use;
};

/// Returns the remark of `DepthEstimator::prepare`.
Result<std::string> open(Network& network, const RecordingOptions& options, const Camera& camera) {
  constexpr std::string_view prefix = "onnx:";
  if (!options.depth.starts_with(prefix)) return std::string();
  auto estimator = make_onnx_depth(options.depth.substr(prefix.size()), camera, {.threads = options.threads});
  if (!estimator) return propagate(estimator);
  network.estimator = *std::move(estimator);
  return network.estimator->prepare();
}

Result<DepthMap> depth_of(const RecordingOptions& options, const Source& source, Network& network, std::size_t index,
                          const FramePair& pair) {
  const auto unbiased = [&]() -> Result<DepthMap> {
    if (network.estimator) {
      const std::scoped_lock lock(network.in_use);
      return network.estimator->estimate(pair);
    }
    if (options.depth == "true") return source.true_depth(index);
    if (options.depth == "stereo") {
      // One for each frame, as they keep scratch memory and frames are read side by side.
      const auto stereo = source.right_camera ? make_stereo_depth(source.camera, *source.right_camera)
                                              : make_stereo_depth(source.camera, *source.baseline_m);
      if (!stereo) return propagate(stereo);
      return (*stereo)->estimate(pair);
    }
    if (options.depth == "topic") return make_topic_depth(source.camera, source.depth_camera)->estimate(pair);
    const auto kind = parse_depth_kind(options.depth_kind);
    if (!kind) return propagate(kind);
    return read_depth({options.depth_dir, *kind, options.depth_scale}, source.names[index], source.camera,
                      source.baseline_m);
  };
  auto depth = unbiased();
  if (depth && options.depth_bias > 0) add_smooth_bias(*depth, options.depth_bias, options.seed);
  return depth;
}

/// A frame of the recording: read, or why it cannot be; and, where it can, why it is of no use.
struct Reading {
  Result<FramePair> pair = fail(ErrorCode::not_read, "");
  Result<DepthMap> depth = fail(ErrorCode::not_read, "");
  std::optional<Error> useless;
};

Reading read_frame(const RecordingOptions& options, const Source& source, Network& network, std::size_t index) {
  Reading reading;
  reading.pair = source.frame(index, network.estimator ? Colours::rgb : Colours::grey);
  if (!reading.pair) return reading;
  reading.depth = depth_of(options, source, network, index, *reading.pair);
  if (!reading.depth) {
    reading.useless = reading.depth.error();
    return reading;
  }
  if (const auto masked = mask_depth(reading.pair->image, {}, *reading.depth); !masked) {
    reading.useless = masked.error();
    return reading;
  }
  const auto features = make_features(*reading.pair, *reading.depth, source.camera, source.T_camera_lidar, {});
  if (!features) reading.useless = features.error();
  return reading;
}

/// Whether a frame that cannot be read costs that frame alone, as a message does that calibd skips. A file of a frame
/// that cannot be read is an error: somebody has put it there.
bool is_skipped(const Error& error, const RecordingOptions& options) {
  return options.dataset == "rosbag2" &&
         (is_malformed(error.code) || error.code == ErrorCode::image_size_mismatch ||
          error.code == ErrorCode::cloud_empty || error.code == ErrorCode::file_unreadable);
}

/// The first few of `phrases`, and how many more there are.
std::string abridged(const std::vector<std::string>& phrases) {
  constexpr std::size_t most = 3;
  std::string text;
  for (std::size_t i = 0; i < std::min(most, phrases.size()); ++i) text += (i == 0 ? "" : ", ") + phrases[i];
  if (phrases.size() > most) text += " (and " + std::to_string(phrases.size() - most) + " more)";
  return text;
}

/// What shows at the recording's own extrinsic before anything is made of it.
Result<void> check_source(const RecordingOptions& options, const Source& source) {
  if (options.depth == "stereo" && !source.has_stereo)
    return fail(ErrorCode::stereo_missing, options.root.string() +
                                               " has no right images, or no baseline is known: stereo depth "
                                               "needs both; give depth files (--depth-dir) instead");
  std::error_code error;
  if (!options.depth_dir.empty() && !std::filesystem::is_directory(options.depth_dir, error))
    return fail(ErrorCode::depth_missing, options.depth_dir.string() + " is not a folder");
  constexpr double largest_vehicle_m = 30;
  const double distance_m = source.T_camera_lidar.translation().norm();
  if (distance_m < largest_vehicle_m) return {};
  return fail(ErrorCode::extrinsic_implausible,
              fmt::format("T_camera_lidar sets camera and LiDAR {:.3g} m apart: is it in millimetres?", distance_m));
}

/// Before frames are blamed for what the extrinsic does. What only the depth speaks against is a remark.
Result<void> check_first(const Reading& first, RecordingFrames& recording_frames) {
  const LidarScan& scan = first.pair->scan;
  const auto likely = examine_extrinsic(recording_frames.camera, recording_frames.T_camera_lidar, scan,
                                        first.depth ? &*first.depth : nullptr)
                          .likely;
  const std::string words = likely ? std::string(likely->words) : "";
  auto plausible = check_extrinsic(recording_frames.camera, recording_frames.T_camera_lidar, scan);
  if (plausible && likely)
    recording_frames.remarks.push_back("T_camera_lidar does not go with the depth: " + words);
  else if (!plausible && likely && plausible.error().context.find(words) == std::string::npos)
    plausible.error().context += "; by the depth, " + words;
  return plausible;
}

std::optional<RecordingAgreement> agreement_of(const RecordingFrames& recording_frames, int threads) {
  const auto& frames = recording_frames.frames;
  struct Pair {
    std::optional<DepthAgreement> own, other;
  };
  std::vector<Pair> pairs(frames.size());
  parallel_for(frames.size(), threads, [&](std::size_t i) {
    const auto with = [&](std::size_t cloud) {
      return depth_agreement(frames[i].depth, recording_frames.camera, recording_frames.T_camera_lidar,
                             frames[cloud].pair.scan);
    };
    pairs[i] = {with(i), with((i + frames.size() / 2) % frames.size())};
  });
  RecordingAgreement agreement;
  std::vector<double> correlations;
  for (const auto& [own, other] : pairs) {
    if (!own) continue;
    correlations.push_back(own->rank_correlation);
    agreement.points += own->points;
    agreement.own_cloud_better += !other || own->rank_correlation > other->rank_correlation;
  }
  if (correlations.empty()) return std::nullopt;
  agreement.frames = correlations.size();
  const auto middle = correlations.begin() + static_cast<std::ptrdiff_t>(correlations.size() / 2);
  std::ranges::nth_element(correlations, middle);
  agreement.rank_correlation = *middle;
  return agreement;
}

/// Of wrong input that can be evaluated all the same: some do that on purpose.
void remark_on_agreement(const RecordingOptions& options, RecordingFrames& recording_frames) {
  if (!recording_frames.agreement) return;
  const RecordingAgreement& agreement = *recording_frames.agreement;
  const std::string numbers =
      fmt::format("(rank correlation {:.2f} over {} points)", agreement.rank_correlation, agreement.points);
  if (!agreement.grows_with_range())
    recording_frames.remarks.push_back(
        "at the recording's own extrinsic the depth does not grow with the LiDAR's range " + numbers + ": " +
        (options.depth_dir.empty() ? "is the extrinsic" : "are --depth-kind and the extrinsic") +
        " right, and do images, depth and clouds belong together?");
}

/// What there is too little of, and why.
std::string too_few(const RecordingFrames& recording_frames, std::size_t tried, const Source& source) {
  const bool all = tried == source.names.size();
  const std::size_t told = source.lacks.empty() ? 0 : 1;  // what frames lack is one sentence of those
  return std::to_string(recording_frames.frames.size()) + " of " +
         std::to_string(tried + (all ? source.lacks.size() : 0)) + " frames can be used, and " +
         std::to_string(RecordingFrames::fewest_frames) + " are needed" +
         (all && !source.lacks.empty() ? ": " + abridged(source.lacks) : "") +
         (recording_frames.left_out.size() > told ? "; " + recording_frames.left_out[told] : "");
}

}  // namespace

std::optional<OptionFault> option_fault(const RecordingOptions& options) {
  const bool is_bag = options.dataset == "rosbag2";
  if (options.dataset != "kitti-360" && options.dataset != "nuscenes" && !options.drive.empty())
    return OptionFault{"--drive", "is for kitti-360 and nuscenes"};
  if (!is_bag && options.depth == "topic") return OptionFault{"--depth", "topic is for rosbag2"};
  if (is_bag && !options.camera.empty()) return OptionFault{"--camera", "is not for rosbag2, which has --image-topic"};
  if (options.dataset == "list" && !options.camera.empty())
    return OptionFault{"--camera", "is not for a list, whose file describes the camera"};
  return std::nullopt;
}

std::vector<std::size_t> spread_evenly(std::size_t available, std::size_t wanted) {
  const std::size_t count = std::min(available, wanted);
  std::vector<std::size_t> indices;
  for (std::size_t i = 0; i < count; ++i)
    indices.push_back(count == 1 ? available / 2 : (i * (available - 1) + (count - 1) / 2) / (count - 1));
  return indices;
}

Result<RecordingFrames> RecordingFrames::read(const RecordingOptions& options) {
  const auto source = open(options);
  if (!source) return propagate(source);
  if (auto good = check_source(options, *source); !good) return propagate(good);
  Network network;
  auto remark = open(network, options, source->camera);
  if (!remark) return propagate(remark);
  const auto indices = spread_evenly(source->names.size(), static_cast<std::size_t>(options.frames));
  std::vector<Reading> readings(indices.size());
  parallel_for(indices.size(), options.threads,
               [&](std::size_t i) { readings[i] = read_frame(options, *source, network, indices[i]); });

  RecordingFrames recording_frames{source->camera, source->T_camera_lidar, {}, {}, {}, {}};
  recording_frames.remarks = source->remarks;
  if (!remark->empty()) recording_frames.remarks.push_back(*std::move(remark));
  if (!source->lacks.empty())
    recording_frames.left_out.push_back(std::to_string(source->lacks.size()) + " of " +
                                        std::to_string(source->lacks.size() + source->names.size()) +
                                        " frames are left out: " + abridged(source->lacks));
  bool is_first = true;
  for (std::size_t i = 0; i < indices.size(); ++i) {
    Reading& reading = readings[i];
    const std::string& name = source->names[indices[i]];
    if (!reading.pair && !is_skipped(reading.pair.error(), options)) return propagate(reading.pair);
    if (reading.pair && std::exchange(is_first, false)) {
      for (const Error& noted : reading.pair->image.notes.remarks)
        recording_frames.remarks.push_back("image of frame " + name + ": " + noted.context);
      for (const Error& noted : reading.pair->scan.notes.remarks)
        recording_frames.remarks.push_back("cloud of frame " + name + ": " + noted.context);
      if (auto plausible = check_first(reading, recording_frames); !plausible) return propagate(plausible);
    }
    if (!reading.pair)
      recording_frames.left_out.push_back("frame " + name + " is left out: " + reading.pair.error().context);
    else if (reading.useless)
      recording_frames.left_out.push_back("frame " + name + " is left out: " + reading.useless->context);
    else
      recording_frames.frames.push_back({name, *std::move(reading.pair), *std::move(reading.depth)});
  }
  if (recording_frames.frames.size() < fewest_frames)
    return fail(ErrorCode::too_few_frames, too_few(recording_frames, indices.size(), *source));
  recording_frames.agreement = agreement_of(recording_frames, options.threads);
  remark_on_agreement(options, recording_frames);
  return recording_frames;
}

Result<std::vector<FeatureSet>> RecordingFrames::features(const FeatureSettings& settings, int threads) const {
  std::vector<Result<FeatureSet>> made(frames.size(), fail(ErrorCode::not_made, ""));
  parallel_for(frames.size(), threads, [&](std::size_t i) {
    made[i] = make_features(frames[i].pair, frames[i].depth, camera, T_camera_lidar, settings);
  });
  std::vector<FeatureSet> features;
  for (auto& one : made) {
    if (!one) return propagate(one);
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
