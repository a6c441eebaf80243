#pragma once

#include <string>
#include <variant>

#include "depth/onnx.hpp"
#include "depth/stereo.hpp"
#include "depth/topic.hpp"

namespace calib {

template <DepthSourceConfig... Kinds>
using OneOf = std::variant<Kinds...>;

/// The table of depth sources. Everything that depends on the kind of a source is a member of its struct. A struct that
/// lacks a member of `DepthSourceConfig` does not compile.
using DepthConfig = OneOf<StereoDepthConfig, OnnxDepthConfig, TopicDepthConfig>;

// Each of these calls the member of `source` with the same name.

[[nodiscard]] const DepthSourceKind& depth_kind(const DepthConfig& source);
/// By the key `source` of the mapping `depth`. Throws `BadConfig`.
[[nodiscard]] DepthConfig read_depth_config(const ConfigNode& node, const CameraConfig& camera);
void add_topics(const DepthConfig& source, const Camera& camera, PairTopics& topics);
[[nodiscard]] Result<void> pin_files(DepthConfig& source);
[[nodiscard]] std::string pinned_text(const DepthConfig& source);
[[nodiscard]] bool has_cameras(const DepthConfig& source, const Camera& camera, const StereoCameraInfo& infos);
[[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_estimator(const DepthConfig& source, const Camera& camera,
                                                                     const StereoCameraInfo& infos);

}  // namespace calib
