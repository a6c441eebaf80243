#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "calib/depth.hpp"

namespace calib {

/// How ONNX Runtime runs a network. The defaults are the ones that need the least memory and processor.
struct OnnxSettings {
  int threads = 1;
  /// Threads wait for work in a busy loop: a little faster with two and more, and takes a whole core each.
  bool spinning = false;
  /// Keeps the tensors' memory between runs: a little faster.
  bool memory_arena = false;
  /// Without it the network is read anew for every estimate, and takes no memory in between.
  bool keep_session = true;
  /// By ONNX Runtime's name, any case, with or without ExecutionProvider: cpu, cuda, tensorrt, openvino, ..
  std::string execution_provider = "cpu";
};

/// Depth from an image by the network that the YAML file `descriptor` describes (depth_model.hpp), for images of
/// `camera`. Reads and checks the descriptor alone; the network is read by `prepare`, or by the first `estimate`.
/// Fails with `bad_config`, and one line `FILE:LINE: key: what is wrong; what to write`.
[[nodiscard]] Result<std::unique_ptr<DepthEstimator>> make_onnx_depth(const std::filesystem::path& descriptor,
                                                                      const Camera& camera,
                                                                      const OnnxSettings& settings);

}  // namespace calib
