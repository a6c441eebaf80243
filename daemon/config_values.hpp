#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "calib/camera.hpp"
#include "calib/config_transform.hpp"

namespace calib {

/// Values that several sections of the configuration have in common. Like `ConfigNode`, each throws `BadConfig` for a
/// value that it refuses.

/// Whether `name` has 1 .. 64 characters, each of a-z, 0-9 or `others`: safe in topics, file names and terminals.
[[nodiscard]] bool is_name(std::string_view name, std::string_view others);

/// A ROS topic, or a DDS topic written `dds:NAME`.
[[nodiscard]] std::string read_topic(const ConfigNode& node);

[[nodiscard]] std::filesystem::path read_absolute_path(const ConfigNode& node);

/// A camera from the keys `model`, `size`, `intrinsics` and `distortion` of a mapping that may have others too.
[[nodiscard]] Camera read_camera_model(const ConfigNode& node);

}  // namespace calib
