#pragma once

#include <string>

#include "calib/depth_model.hpp"

namespace calib {

/// The bytes of `model.file`, once their SHA-256 is the pinned one and nothing in them names another file.
/// Fails with `depth_failed`.
[[nodiscard]] Result<std::string> read_model_file(const DepthModel& model);

/// Whether the ONNX model in `bytes` keeps tensors in other files, which whoever loads it would open, wherever a
/// path in it leads. Nothing when `bytes` cannot be a model.
[[nodiscard]] std::optional<bool> has_external_data(std::string_view bytes);

}  // namespace calib
