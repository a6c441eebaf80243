#pragma once

#include <concepts>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "calib/config_node.hpp"
#include "calib/depth.hpp"
#include "dds/stereo_cameras.hpp"
#include "dds/window.hpp"

namespace calib {

struct CameraConfig;

/// What all depth sources of one kind have in common.
struct DepthSourceKind {
  std::string_view name;  // the value of `depth.source` in the configuration
  bool is_metric;         // depth in metres; otherwise up to an unknown monotone scale
  bool is_monocular;      // estimated from one image by a network
  Colour colour;          // of the camera's image

  /// What `calibctl doctor` advises when depth ...
  struct Remedies {
    std::string_view few_valid;    // ... covers too little of the image
    std::string_view inverted;     // ... has near and far exchanged
    std::string_view wrong_scale;  // ... disagrees with the ranges of the cloud by a factor
  } remedies;

  /// Set for sources that are prepared from files alone: `calibctl doctor` reports their failure even when no image
  /// arrives, with this code and these sentences.
  struct PreparationFailure {
    ErrorCode code;
    std::string_view cause, remedy;
  };
  std::optional<PreparationFailure> preparation_failure;
};

/// What the configuration of a depth source provides. To add a kind: write a struct like this in a file of its own, and
/// name it in `DepthConfig` (depth/depth_config.hpp).
template <typename T>
concept DepthSourceConfig =
    requires(T& config, const T& source, const ConfigNode& node, const CameraConfig& camera_config,
             const Camera& camera, const StereoCameraInfo& infos, PairTopics& topics) {
      { T::kind } -> std::same_as<const DepthSourceKind&>;
      /// Reads the mapping `depth` of a pair. Throws `BadConfig`.
      { T::read(node, camera_config) } -> std::same_as<T>;
      /// Adds the topics that the source reads, with the sizes that their images may have.
      { source.add_topics(camera, topics) } -> std::same_as<void>;
      /// When calibd starts: remembers a digest of each file that must not change from then on, and loads the libraries
      /// that only this source needs. Fails with `bad_config`.
      { config.pin_files() } -> std::same_as<Result<void>>;
      /// What evidence depends on beside the text of the configuration, as lines `KEY:VALUE\n`: those digests.
      { source.pinned_text() } -> std::same_as<std::string>;
      /// Whether `infos` holds all that `make_estimator` needs.
      { source.has_cameras(camera, infos) } -> std::same_as<bool>;
      /// An estimator for images of `camera`; `has_cameras` is true. Fails with `bad_camera`, `bad_config`,
      /// `config_not_found` or `depth_failed`.
      { source.make_estimator(camera, infos) } -> std::same_as<Result<std::unique_ptr<DepthEstimator>>>;
    };

}  // namespace calib
