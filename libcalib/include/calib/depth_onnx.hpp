#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "calib/depth.hpp"

namespace calib {

/// How ONNX Runtime runs a network. The defaults need little memory and processor; tests/bench/README.md has figures.
struct OnnxSettings {
  int threads = 1;
  /// Threads wait for work in a busy loop: a little faster with two and more, and takes a whole core each.
  bool spinning = false;
  /// Keeps the tensors' memory between runs: a little faster, for several times the network's own memory.
  bool memory_arena = false;
  /// Without it the network is read anew for every estimate, and ONNX Runtime alone takes memory in between.
  bool keep_session = true;
  /// By ONNX Runtime's name, any case, with or without ExecutionProvider: cpu, cuda, tensorrt, openvino, ..
  std::string execution_provider = "cpu";
};

/// Whether this libcalib was built with ONNX Runtime (CALIB_WITH_ONNX).
[[nodiscard]] bool has_onnx();
/// Loads ONNX Runtime, once. It is not linked, so that a program which uses another depth source needs neither its
/// memory nor the library itself. Fails with `bad_config`. `make_onnx_depth` calls it, too.
[[nodiscard]] Result<void> load_onnx_runtime();

/// Depth from an image by the network that the YAML file `descriptor` describes (depth_model.hpp), for images of
/// `camera`. Reads and checks the descriptor alone; the network is read by `prepare`, or by the first `estimate`.
/// Fails as `load_depth_model` does, and with `bad_config` without ONNX Runtime or when the camera's images would
/// become too large for it.
///
/// An image is grey to a colour network when it has no `rgb`. Whatever else is wrong, with the network's file, its
/// inputs and outputs or what comes out, fails `prepare` and every `estimate` with `depth_failed`; a golden pair that
/// does not fit with a text that begins "depth model self-test failed". On the CPU, estimates do not depend on
/// the settings.
[[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_onnx_depth(const std::filesystem::path& descriptor,
                                                                      const Camera& camera,
                                                                      const OnnxSettings& settings);

}  // namespace calib
