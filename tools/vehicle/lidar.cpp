#include "vehicle/lidar.hpp"

#include <array>
#include <cmath>
#include <limits>

#include "vehicle/facing_triangle.hpp"

namespace calib::vehicle {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

constexpr int beams = 64;
constexpr float pi = 3.14159265f;

/// Distance of the origin from the segment p-q.
float distance_to_origin(const Vector2f& p, const Vector2f& q) {
  const Vector2f along = q - p;
  const float share = std::clamp(-p.dot(along) / std::max(along.squaredNorm(), 1e-12f), 0.f, 1.f);
  return (p + share * along).norm();
}

/// Ranges of every ray to what it meets first. Instead of following each ray through the scene, every
/// triangle is tried against the few rays that can meet it: exact, and without an index of the scene.
class RangeImage {
 public:
  struct Hit {
    float range = std::numeric_limits<float>::max();
    int target = -1;
  };
  /// A triangle that some ray has met.
  struct Target {
    Vector3f normal;  // unit
    TextureMap texture;
    Surface surface;
  };

  explicit RangeImage(const LidarModel& model)
      : columns_(static_cast<int>(std::lround(model.field_of_view_deg / model.azimuth_step_deg))),
        step_(static_cast<float>(model.azimuth_step_deg * radians_per_degree)),
        whole_turn_(static_cast<int>(std::lround(360 / model.azimuth_step_deg))),
        hits_(columns_ * beams) {
    for (int i = 0; i < beams; ++i) {
      const double degrees = i < 32 ? 2 - i / 3.0 : -8.83 - (i - 32) / 2.0;
      sine_[i] = static_cast<float>(std::sin(degrees * radians_per_degree));
      cosine_[i] = static_cast<float>(std::cos(degrees * radians_per_degree));
      tangent_[i] = sine_[i] / cosine_[i];
    }
  }

  void add(const Triangle& triangle, const FacingTriangle& facing, float max_range) {
    const Vector2f a = facing.a.head<2>(), b = facing.b.head<2>(), c = facing.c.head<2>();
    float nearest = std::min({distance_to_origin(a, b), distance_to_origin(b, c), distance_to_origin(c, a)});
    const auto cross = [](const Vector2f& p, const Vector2f& q) { return p.x() * q.y() - p.y() * q.x(); };
    const float ab = cross(a, b), bc = cross(b, c), ca = cross(c, a);
    const bool around_axis = (ab >= 0 && bc >= 0 && ca >= 0) || (ab <= 0 && bc <= 0 && ca <= 0);
    if (around_axis) nearest = 0;
    if (nearest > max_range) return;

    const auto [first_beam, last_beam] = beams_between(facing, std::max(nearest, 1e-3f));
    if (first_beam > last_beam) return;
    const int id = static_cast<int>(met_.size());
    bool met = false;
    const auto [from, to] = columns_between(a, b, c, around_axis);
    const std::array<Vector3f, 3> edges{facing.a.cross(facing.b), facing.b.cross(facing.c), facing.c.cross(facing.a)};
    for (int i = from; i <= to; ++i)
      if (const int column = (i % whole_turn_ + whole_turn_) % whole_turn_; column < columns_)
        met |= meet(facing, edges, column, first_beam, last_beam, max_range, id);
    if (met) met_.push_back({facing.normal.normalized(), TextureMap(triangle, facing), triangle.surface});
  }

  [[nodiscard]] int columns() const { return columns_; }
  [[nodiscard]] const Hit& hit(int column, int beam) const { return hits_[column * beams + beam]; }
  [[nodiscard]] const Target& target(const Hit& hit) const { return met_[hit.target]; }
  [[nodiscard]] Vector3f direction(int column, int beam) const {
    const float azimuth = azimuth_of(column);
    return {cosine_[beam] * std::cos(azimuth), cosine_[beam] * std::sin(azimuth), sine_[beam]};
  }

 private:
  /// Column 0 looks to the right edge of the field of view; azimuth grows to the left.
  [[nodiscard]] float azimuth_of(int column) const {
    return step_ * (static_cast<float>(column) - 0.5f * static_cast<float>(columns_));
  }

  /// Beams that may meet the triangle, from its heights and its horizontal distances.
  [[nodiscard]] std::pair<int, int> beams_between(const FacingTriangle& facing, float nearest) const {
    const float farthest = std::max({facing.a.head<2>().norm(), facing.b.head<2>().norm(), facing.c.head<2>().norm()});
    const float high = std::max({facing.a.z(), facing.b.z(), facing.c.z()}),
                low = std::min({facing.a.z(), facing.b.z(), facing.c.z()});
    const float steepest_up = high / (high > 0 ? nearest : farthest),
                steepest_down = low / (low < 0 ? nearest : farthest);
    int first = 0, last = beams - 1;
    while (first < beams && tangent_[first] > steepest_up + 1e-5f) ++first;
    while (last >= 0 && tangent_[last] < steepest_down - 1e-5f) --last;
    return {first, last};
  }

  /// Columns (not yet wrapped to one turn) that may meet the triangle with these corners seen from above.
  [[nodiscard]] std::pair<int, int> columns_between(const Vector2f& a, const Vector2f& b, const Vector2f& c,
                                                    bool around_axis) const {
    if (around_axis) return {0, whole_turn_ - 1};
    const float first = std::atan2(a.y(), a.x());
    // The other corners within half a turn of the first.
    const auto beside = [&](const Vector2f& p) { return std::remainder(std::atan2(p.y(), p.x()) - first, 2 * pi); };
    const float low = first + std::min({0.f, beside(b), beside(c)}),
                high = first + std::max({0.f, beside(b), beside(c)});
    const float offset = 0.5f * static_cast<float>(columns_);
    return {static_cast<int>(std::ceil(low / step_ + offset - 1e-3f)),
            static_cast<int>(std::floor(high / step_ + offset + 1e-3f))};
  }

  bool meet(const FacingTriangle& facing, const std::array<Vector3f, 3>& edges, int column, int first_beam,
            int last_beam, float max_range, int id) {
    const float c = std::cos(azimuth_of(column)), s = std::sin(azimuth_of(column));
    const auto level = [&](const Vector3f& n) { return c * n.x() + s * n.y(); };
    const float e0 = level(edges[0]), e1 = level(edges[1]), e2 = level(edges[2]), n = level(facing.normal);
    const float distance = facing.normal.dot(facing.a);
    bool met = false;
    for (int beam = first_beam; beam <= last_beam; ++beam) {
      const float up = sine_[beam], ahead = cosine_[beam];
      // Inside: the ray is on the inner side of the three planes through the origin and an edge.
      if (ahead * e0 + up * edges[0].z() > 0 || ahead * e1 + up * edges[1].z() > 0 ||
          ahead * e2 + up * edges[2].z() > 0)
        continue;
      const float slope = ahead * n + up * facing.normal.z();
      if (slope >= 0) continue;
      const float range = distance / slope;
      Hit& best = hits_[column * beams + beam];
      if (range < best.range && range < max_range) best = {range, id}, met = true;
    }
    return met;
  }

  int columns_;
  float step_;
  int whole_turn_;
  std::array<float, beams> sine_{}, cosine_{}, tangent_{};
  std::vector<Hit> hits_;
  std::vector<Target> met_;
};

/// Near infrared is not what a camera sees: foliage is bright in it, paint and cloth less so; signs reflect
/// back.
float infrared(Material material, float visible) {
  switch (material) {
    case Material::leaves:
      return std::min(1.f, 2.2f * visible);
    case Material::sign:
      return 0.9f;
    case Material::glass:
      return 0.5f * visible;
    default:
      return visible;
  }
}

}  // namespace

LidarScan scan(const Scene& scene, const std::vector<Instance>& instances, const LidarModel& model,
               const RigidTransform& T_world_lidar, std::uint64_t key) {
  RangeImage image(model);
  const RigidTransform T_lidar_world = T_world_lidar.inverse();
  for (const Instance& instance : instances) {
    const Eigen::Isometry3f T_lidar_mesh = (T_lidar_world * instance.T_world_mesh).cast<float>();
    for (const Triangle& triangle : instance.mesh->triangles) {
      const FacingTriangle facing(triangle, T_lidar_mesh);
      if (facing.faces_origin()) image.add(triangle, facing, model.max_range_m);
    }
  }

  LidarScan result;
  result.points.reserve(image.columns() * beams);
  for (int column = 0; column < image.columns(); ++column)
    for (int beam = 0; beam < beams; ++beam) {
      const RangeImage::Hit& hit = image.hit(column, beam);
      if (hit.target < 0) continue;
      const RangeImage::Target& target = image.target(hit);
      const Vector3f direction = image.direction(column, beam);
      const Vector3f p = hit.range * direction;
      const float spot = 0.003f * hit.range;
      const float cosine = -direction.dot(target.normal);
      const float visible = albedo(scene.noise(), target.surface, target.texture.u(p), target.texture.v(p), spot, spot);
      const float reflectance =
          std::clamp(infrared(target.surface.material, visible) * (0.3f + 0.7f * cosine), 0.f, 1.f);
      float range = hit.range;
      if (!model.ideal) {
        Random random(mix(key, column, beam));
        // What comes back falls with the square of the range; a dark, slanting or far surface gives none.
        const float echo = reflectance * (0.2f + cosine) * (80 / range) * (80 / range);
        if (random.chance(model.dropout) || echo < random.uniform(0.05f, 0.12f)) continue;
        range += model.range_sigma_m * random.gaussian();
      }
      const Vector3f measured = range * direction;
      result.points.push_back({measured.x(), measured.y(), measured.z(), 0.01f * std::round(100 * reflectance)});
    }
  return result;
}

}  // namespace calib::vehicle
