#include "vehicle/scene.hpp"

#include <cmath>

#include "vehicle/furniture.hpp"

namespace calib::vehicle {
namespace {

constexpr double speed_m_s = 8;
constexpr double ahead_m = 160, behind_m = 90;
constexpr double own_lane_m = -1.8, other_lane_m = 1.8;

enum Purpose : std::uint64_t { noise = 100, oncoming, walker, leader, sun };

}  // namespace

Scene::Scene(std::uint64_t seed) : seed_(mix(seed)), street_(seed_), noise_(mix(seed_, Purpose::noise)) {
  Random random(mix(seed_, Purpose::sun));
  const double azimuth = random.uniform(0, 6.2831853f);
  light_.sun = Eigen::Vector3d(std::cos(azimuth), std::sin(azimuth), 0.9).normalized();
}

double Scene::station(double t_s) const { return speed_m_s * t_s + 9 * std::sin(t_s / 7); }

RigidTransform Scene::T_world_vehicle(double t_s) const {
  const double d = own_lane_m + 0.25 * std::sin(0.43 * t_s) + 0.1 * std::sin(1.1 * t_s + 1);
  RigidTransform pose = street_.pose_at(station(t_s), d);
  const double roll = 0.010 * std::sin(1.7 * t_s + 0.5), pitch = 0.007 * std::sin(2.3 * t_s + 2);
  const double yaw = 0.02 * std::sin(0.43 * t_s + 1.5);
  pose.rotate(Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()));
  pose.rotate(Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()));
  pose.rotate(Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()));
  return pose;
}

const Mesh& Scene::model(std::uint64_t key, void (*add)(Mesh&, const Eigen::Isometry3f&, Random&)) {
  const auto [found, inserted] = models_.try_emplace(key);
  if (inserted) {
    Random random(key);
    add(found->second, Eigen::Isometry3f::Identity(), random);
  }
  return found->second;
}

void Scene::add_traffic(double t_s, std::vector<Instance>& result) {
  const double here = station(t_s);
  /// Things one after another every `spacing` metres, moving on at `speed`.
  const auto add_row = [&](Purpose purpose, double spacing, double speed, double height, auto&& lateral, auto add) {
    const double shift = speed * t_s;
    const int first = static_cast<int>(std::floor((here - behind_m - shift) / spacing));
    const int last = static_cast<int>(std::ceil((here + ahead_m - shift) / spacing));
    for (int i = first; i <= last; ++i) {
      Random random(mix(seed_, purpose, i));
      const double x = spacing * i + random.uniform(-0.35f, 0.35f) * spacing + shift;
      if (random.chance(0.25f)) continue;
      RigidTransform pose = street_.pose_at(x, lateral(random));
      pose.translate(Eigen::Vector3d(0, 0, height));
      if (speed < 0) pose.rotate(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()));
      // Few models, so that none has to be made while driving for long.
      result.push_back({&model(mix(seed_, purpose, 1000 + random.below(12)), add), pose});
    }
  };
  add_row(
      Purpose::oncoming, 28, -7, 0, [](Random& random) { return other_lane_m + random.uniform(-0.2f, 0.2f); }, add_car);
  for (const double direction : {-1.3, 1.2})
    for (const double side : {-1.0, 1.0})
      add_row(
          Purpose::walker, direction > 0 ? 11 : 14, direction, Street::kerb_height_m,
          [&](Random& random) { return side * (7.8 + 0.5 * direction + random.uniform(-0.3f, 0.3f)); }, add_person);

  // Cars ahead in the own lane that close up and fall back.
  for (int i = 0; i < 3; ++i) {
    const double x = here + 24 + 34 * i + 8 * std::sin(t_s / (9 + i) + 2 * i);
    result.push_back({&model(mix(seed_, Purpose::leader, i, static_cast<std::uint64_t>(t_s / 60)), add_car),
                      street_.pose_at(x, own_lane_m + 0.15 * std::sin(0.3 * t_s + i))});
  }
}

std::vector<Instance> Scene::instances(double t_s) {
  const double here = station(t_s);
  const int first = static_cast<int>(std::floor((here - behind_m) / Street::block_m));
  const int last = static_cast<int>(std::floor((here + ahead_m) / Street::block_m));
  std::erase_if(blocks_, [&](const auto& entry) { return entry.first < first || entry.first > last; });
  if (models_.size() > 200) models_.clear();

  std::vector<Instance> result;
  for (int i = first; i <= last; ++i) {
    const auto [found, inserted] = blocks_.try_emplace(i);
    if (inserted) found->second = street_.block(i);
    result.push_back({&found->second, street_.pose_at(i * Street::block_m, 0)});
  }
  add_traffic(t_s, result);
  return result;
}

}  // namespace calib::vehicle
