#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "calib/depth_agreement.hpp"
#include "calib/depth_model.hpp"
#include "calib/depth_onnx.hpp"

namespace calib::ctl {

/// What a network is run on. Without a scan nothing measures its depth; without intrinsics of its own, `camera` is a
/// guess that has the image's size.
struct NetworkFrame {
  std::string name;
  FramePair pair;
  Camera camera;
  bool camera_is_known = false;
  bool shows_a_road = true;  // near below, far above; not known of a golden image
  std::optional<RigidTransform> T_camera_lidar;
};

/// What looks wrong though the network runs, and the key of the descriptor (or the argument) that mends it.
struct Suspicion {
  std::string code, seen, remedy;
};

/// A network that has passed its self-test, and what it made of a frame.
struct NetworkReport {
  DepthModel model;
  int input_width = 0, input_height = 0;  // for this frame
  std::string remark;                     // of `DepthEstimator::prepare`
  double run_ms = 0;                      // median of `runs`, preprocessing included
  double valid_share = 0;                 // of the pixels
  static constexpr std::array quantiles{0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99};
  /// Of the pixels with depth, from near to far; nothing where there are none. Metres where the output is metric and
  /// the camera is known.
  std::optional<std::array<double, quantiles.size()>> depth;
  /// Median inverse depth of the lower half of the pixels with depth, over that of the upper half; on a road the lower
  /// one is nearer. Nothing where either is empty.
  std::optional<double> lower_over_upper;
  std::optional<DepthAgreement> agreement;  // with the frame's scan
  std::vector<Suspicion> suspicions;
};

/// Runs the network `runs` times (odd) on `frame`, after `DepthEstimator::prepare`: hash, inputs and outputs, golden
/// pair. Fails as `make_onnx_depth`, `prepare` and `estimate` do.
[[nodiscard]] Result<NetworkReport> check_network(const DepthModel& model, const NetworkFrame& frame, int runs,
                                                  const OnnxSettings& settings);

/// What the descriptor alone makes suspicious.
[[nodiscard]] std::vector<Suspicion> suspicions_of(const NetworkInput& input);

[[nodiscard]] std::string_view semantics_name(DepthSemantics semantics);

}  // namespace calib::ctl
