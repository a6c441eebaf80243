// Reads a camera as a line of JSON, {"model", "size", "intrinsics", "distortion"}, then points as float64 x y z; writes
// the pixel of each as float64 u v, NaN where it is not visible, and before them the camera's largest angle.

#include <array>
#include <cstdio>
#include <iostream>
#include <limits>
#include <nlohmann/json.hpp>

#include "calib/camera.hpp"
#include "support/support.hpp"

int main() {
  using calib::test::require_ok;
  try {
    std::string line;
    std::getline(std::cin, line);
    const auto json = nlohmann::json::parse(line);
    const auto size = json.at("size").get<std::array<int, 2>>();
    const calib::Camera camera = require_ok(calib::Camera::make(
        require_ok(calib::parse_camera_model(json.at("model").get<std::string>())), size[0], size[1],
        json.at("intrinsics").get<std::vector<double>>(), json.at("distortion").get<std::vector<double>>()));
    const double max_angle_rad = camera.max_angle_rad();
    std::cout.write(reinterpret_cast<const char*>(&max_angle_rad), sizeof max_angle_rad);
    constexpr double unseen = std::numeric_limits<double>::quiet_NaN();
    for (std::array<double, 3> p; std::cin.read(reinterpret_cast<char*>(p.data()), sizeof p);) {
      const Eigen::Vector2d uv = camera.project({p[0], p[1], p[2]}).value_or(Eigen::Vector2d(unseen, unseen));
      std::cout.write(reinterpret_cast<const char*>(uv.data()), 2 * sizeof(double));
    }
  } catch (const std::exception& e) {
    std::fprintf(stderr, "project_points: %s\n", e.what());
    return 1;
  }
}
