#pragma once

#include <filesystem>
#include <vector>

#include "calib_eval/experiment.hpp"

namespace calib::eval {

/// How often a class of a point's feature (row) met a class of the feature of the pixel that it lands on (column), in
/// one frame. Classes hold equal numbers of all values there are, in rising order: of distance and depth, or of
/// reflectance and brightness.
struct JointHistogram {
  static constexpr int classes = 30;
  std::vector<int> counts = std::vector<int>(classes * classes);
};
enum class Features { depth, intensity };
[[nodiscard]] JointHistogram joint_histogram(const FeatureSet& frame, const RigidTransform& T_camera_lidar,
                                             Features features);

/// One run of a cell, for looking at: before, after, and as it ought to be.
struct Figure {
  struct View {
    const char* name;  // start, end, truth
    double score = 0;  // of the last stage's objective, in this frame
    JointHistogram histogram;
    std::filesystem::path overlay;
  };
  std::size_t run = 0;
  std::string frame;
  Features features = Features::depth;
  std::vector<View> views;
};

/// A run from the middle of the sphere, where all axes are off, in the frame in the middle of the recording. Writes its
/// overlays, the LiDAR's points coloured by range on the image, into `folder`, which must be there. Nothing when that
/// run has no result. Fails with `write_failed`, and as `make_features` does.
[[nodiscard]] Result<std::optional<Figure>> draw(const RecordingFrames& recording_frames, const Experiment& experiment,
                                                 const std::filesystem::path& folder);

}  // namespace calib::eval
