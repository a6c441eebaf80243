#include "calib/depth_onnx.hpp"

namespace calib {

// In place of depth_onnx.cpp where CALIB_WITH_ONNX is off.

bool has_onnx() { return false; }

Result<void> load_onnx_runtime() {
  return fail(ErrorCode::bad_config,
              "this calibd was built without ONNX Runtime (CALIB_WITH_ONNX=OFF) and takes no depth from a network; use "
              "another depth source");
}

Result<std::unique_ptr<DepthEstimator>> make_onnx_depth(const std::filesystem::path&, const Camera&,
                                                        const OnnxSettings&) {
  return propagate(load_onnx_runtime());
}

}  // namespace calib
