#include "calib/depth_onnx.hpp"

namespace calib {

// In place of depth_onnx.cpp where CALIB_WITH_ONNX is off.

bool has_onnx() { return false; }

Result<std::unique_ptr<DepthEstimator>> make_onnx_depth(const std::filesystem::path& descriptor, const Camera&,
                                                        const OnnxSettings&) {
  return fail(ErrorCode::bad_config, descriptor.string() +
                                         ": this calibd was built without ONNX Runtime (CALIB_WITH_ONNX=OFF) " +
                                         "and takes no depth from a network; use another depth source");
}

}  // namespace calib
