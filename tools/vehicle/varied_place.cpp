#include "vehicle/varied_place.hpp"

#include <algorithm>
#include <cmath>

#include "dataset/depth_files.hpp"
#include "dataset/image_file.hpp"
#include "vehicle/roadside.hpp"

namespace calib::vehicle {
namespace {

enum Purpose : std::uint64_t { place = 200, camera, light, noise, exposure };

Camera any_camera(Random& random, int width, int height) {
  const double half_angle = random.uniform(0.35f, 0.96f), focal = 0.5 * width / std::tan(half_angle);
  const double cx = 0.5 * width + width * static_cast<double>(random.uniform(-0.04f, 0.04f)),
               cy = 0.5 * height + height * static_cast<double>(random.uniform(-0.06f, 0.06f));
  return Camera::make(CameraModel::rectified, width, height, {focal, focal, cx, cy}).value();
}

/// From the vehicle's place on the road to a camera on it that looks ahead, more or less.
RigidTransform any_mounting(Random& random) {
  Eigen::Matrix3d R_vehicle_optical;
  R_vehicle_optical << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  const double degree = M_PI / 180;
  const double yaw = random.gaussian() * (random.chance(0.2f) ? 25 : 5) * degree;
  const double pitch = random.uniform(-6, 6) * random.uniform(0.3f, 1) * degree,
               roll = 1.2 * random.gaussian() * degree;
  RigidTransform mounting = RigidTransform::Identity();
  mounting.linear() =
      (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
          .toRotationMatrix() *
      R_vehicle_optical;
  mounting.translation().z() = random.uniform(1.2f, 2.2f);
  return mounting;
}

Light any_light(Random& random) {
  Light light;
  const double azimuth = random.uniform(0, 6.2831853f), elevation = random.uniform(0.2f, 1.2f);
  light.sun = Eigen::Vector3d(std::cos(azimuth) * std::cos(elevation), std::sin(azimuth) * std::cos(elevation),
                              std::sin(elevation));
  light.cast_shadows = random.chance(0.75f);
  if (light.cast_shadows) {
    light.sunlight = random.uniform(0.4f, 1.3f);
    light.skylight = random.uniform(0.08f, 0.4f);
  } else {
    light.sunlight = random.uniform(0, 0.4f);
    light.skylight = random.uniform(0.3f, 0.8f);
  }
  light.haze_m = std::exp(random.uniform(4.8f, 8.f));
  light.horizon = random.uniform(0.45f, 1.6f);
  light.drop = light.horizon * random.uniform(0, 0.7f);
  light.clouds = random.uniform(0, 0.15f) * random.uniform(0, 1);
  light.haze = light.horizon * random.uniform(0.5f, 1);
  return light;
}

}  // namespace

VariedView varied_view(const NoiseTexture& noise, std::uint64_t seed, std::size_t index, int width, int height) {
  const auto stream = [&](Purpose purpose) { return Random(mix(seed, index, purpose)); };
  Random camera_random = stream(Purpose::camera), light_random = stream(Purpose::light);
  Roadside roadside(mix(seed, index, Purpose::place));
  const float d = camera_random.uniform(-0.9f, 0.9f) * roadside.half_width();
  roadside.fill(d);

  const Light light = any_light(light_random);
  const Camera camera = any_camera(camera_random, width, height);
  const RigidTransform T_world_camera = roadside.pose(0, d, 0, 0).cast<double>() * any_mounting(camera_random);
  Rendering rendering = render(noise, light, {{&roadside.mesh(), RigidTransform::Identity()}}, camera, T_world_camera);
  const float exposure = std::exp(light_random.uniform(-0.8f, 1.f));
  Image image = expose(rendering, exposure, mix(seed, index, Purpose::exposure));
  return {camera, std::move(rendering), std::move(image)};
}

Result<void> dump_varied_views(const std::filesystem::path& folder, std::uint64_t seed, std::size_t count, int width,
                               int height) {
  std::error_code error;
  for (const char* name : {"images", "depth"})
    if (std::filesystem::create_directories(folder / name, error); error)
      return fail(ErrorCode::write_failed, (folder / name).string() + " cannot be made: " + error.message());
  const NoiseTexture texture(mix(seed, Purpose::noise));
  for (std::size_t i = 0; i < count; ++i) {
    const VariedView view = varied_view(texture, seed, i, width, height);
    std::string name = std::to_string(i);
    name.insert(0, 6 - std::min<std::size_t>(name.size(), 6), '0');
    const auto file = [&](const char* kind) { return folder / kind / (name + ".png"); };
    if (const auto written = write_image(file("images"), view.image); !written) return written;
    if (const auto written = write_range_png(file("depth"), width, height, view.rendering.depth_m); !written)
      return written;
  }
  return {};
}

}  // namespace calib::vehicle
