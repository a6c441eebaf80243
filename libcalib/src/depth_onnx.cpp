#include "calib/depth_onnx.hpp"

namespace calib {

Result<std::unique_ptr<DepthEstimator>> make_onnx_depth(const std::filesystem::path& descriptor, const Camera&,
                                                        const OnnxSettings&) {
  return fail("bad_config", descriptor.string() + ":1: depth from a network is not in this build");
}

}  // namespace calib
