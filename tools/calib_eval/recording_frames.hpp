#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calib/features.hpp"
#include "dataset/bag/bag_options.hpp"
#include "dataset/recording.hpp"

namespace calib::eval {

/// Layouts of recordings.
inline constexpr std::array datasets{"kitti-raw", "kitti-360", "kitti-object", "nuscenes", "rosbag2", "list"};

/// Which frames of which recording, and where their depth comes from.
struct RecordingOptions {
  std::string dataset;  // one of `datasets`, or sim: streets that are simulated
  std::filesystem::path root;
  std::string cloud_layout;   // of clouds in .bin; empty: what the recording says, or float32x4
  std::string drive, camera;  // empty: the layout's usual camera
  BagOptions bag;             // of rosbag2
  std::string depth;          // stereo, onnx:DESCRIPTOR, topic or, of simulated streets, true; empty: from files
  std::filesystem::path depth_dir;
  std::string depth_kind;
  std::optional<double> depth_scale;
  bool monocular_files = false;  // depth in files is of one image, by a network
  double depth_bias = 0;
  std::uint64_t seed = 1;
  int frames = 25;
  int threads = 1;
  int places = 8;        // sim: streets, of seeds from `seed` on
  double period_s = 10;  // sim: of driving, between two frames

  [[nodiscard]] bool monocular_depth() const { return monocular_files || depth.starts_with("onnx:"); }
};

/// An option that the layout of the recording has no use for.
struct OptionFault {
  std::string option, why;
};
[[nodiscard]] std::optional<OptionFault> option_fault(const RecordingOptions& options);

/// How the depth of a recording agrees with its clouds, at its own extrinsic.
struct RecordingAgreement {
  double rank_correlation = 0;  // of depth and range, median over the frames: `DepthAgreement`
  std::size_t points = 0;       // that it is of
  /// Frames, and those of them whose depth agrees better with their own cloud than with that of the frame half a
  /// recording away.
  std::size_t frames = 0, own_cloud_better = 0;

  /// With good depth 0.95 and more; 0.4 where the LiDAR is rotated by 20 degrees; negative where depth is inverted.
  [[nodiscard]] bool grows_with_range() const { return rank_correlation >= 0.5; }
};

/// Frames that can be evaluated, with their depth. What is wrong with the others is in `left_out`, a sentence each.
struct RecordingFrames {
  struct Frame {
    std::string name;
    FramePair pair;
    DepthMap depth;
  };

  Camera camera;
  RigidTransform T_camera_lidar;
  std::vector<Frame> frames;
  std::vector<std::string> left_out;
  std::optional<RecordingAgreement> agreement;  // nothing where hardly a point projects to depth
  /// What looks wrong, a sentence each.
  std::vector<std::string> remarks;

  /// Fewer frames carry too little information.
  static constexpr std::size_t fewest_frames = 3;

  /// Reads `options.frames` frames spread evenly over the recording (all, where it has no more), and makes or reads
  /// their depth; or drives through simulated streets for them. Fails as opening the recording and reading its frames
  /// do; as `make_onnx_depth` and the network's self-test do; with `extrinsic_implausible`, `stereo_missing`,
  /// `depth_missing` and `too_few_frames`. Frames without usable depth or overlap are left out, and so are messages
  /// that calibd would not accept.
  [[nodiscard]] static Result<RecordingFrames> read(const RecordingOptions& options);

  /// Features of all frames at the recording's extrinsic. Fails as `make_features` does.
  [[nodiscard]] Result<std::vector<FeatureSet>> features(const FeatureSettings& settings, int threads) const;
};

/// Numbers of `wanted` out of `available` frames, spread evenly from the first to the last.
[[nodiscard]] std::vector<std::size_t> spread_evenly(std::size_t available, std::size_t wanted);

[[nodiscard]] std::vector<const FeatureSet*> pointers(const std::vector<FeatureSet>& features);

}  // namespace calib::eval
