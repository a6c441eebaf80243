#include "vehicle/vegetation.hpp"

#include <algorithm>
#include <cmath>

namespace calib::vehicle {
namespace {

using Eigen::Vector3f;

Surface surface_of(Material material, Random& random) { return {material, static_cast<std::uint32_t>(random.bits())}; }

Vector3f random_direction(Random& random) {
  const float z = random.uniform(-1, 1), angle = random.uniform(0, 6.2831853f), r = std::sqrt(1 - z * z);
  return {r * std::cos(angle), r * std::sin(angle), z};
}

/// A triangle that is seen from both sides.
void add_card(Mesh& mesh, const std::array<Vector3f, 3>& p, Surface surface) {
  const std::array<Corner, 3> c{Corner{p[0], 0, 0}, Corner{p[1], (p[1] - p[0]).norm(), 0},
                                Corner{p[2], 0.5f * (p[1] - p[0]).norm(), (p[2] - p[0]).norm()}};
  mesh.add_triangle(c[0], c[1], c[2], surface);
  mesh.add_triangle(c[0], c[2], c[1], surface);
}

/// Clusters of leaves about the shell of an ellipsoid.
void add_leaves(Mesh& mesh, const Vector3f& centre, const Vector3f& radii, int cards, float size, Random& random) {
  const Surface light = surface_of(Material::foliage, random), dark = surface_of(Material::foliage, random);
  for (int i = 0; i < cards; ++i) {
    const Vector3f middle = centre + radii.cwiseProduct(random_direction(random)) * random.uniform(0.75f, 1.12f);
    std::array<Vector3f, 3> corners;
    for (Vector3f& corner : corners) corner = middle + random_direction(random) * size * random.uniform(0.5f, 1.2f);
    add_card(mesh, corners, random.chance(0.7f) ? light : dark);
  }
}

}  // namespace

void add_bush(Mesh& mesh, const Vector3f& centre, const Vector3f& radii, int cards, Random& random) {
  mesh.add_blob(centre, 0.92f * radii, 0.3f, random.bits(), surface_of(Material::foliage, random));
  add_leaves(mesh, centre, radii, cards, 0.17f * std::cbrt(radii.prod()), random);
}

void add_ragged_tree(Mesh& mesh, const Eigen::Isometry3f& pose, float height, int cards, Random& random) {
  const float trunk = height * random.uniform(0.12f, 0.4f), radius = height * random.uniform(0.012f, 0.035f);
  mesh.add_tube(pose, radius, 0.6f * radius, std::max(trunk, 0.7f * height), 6, surface_of(Material::bark, random));
  const float spread = height * random.uniform(0.14f, 0.42f);
  const bool pointed = random.chance(0.2f);
  const int parts = pointed ? 3 : 2 + random.below(3);
  for (int i = 0; i < parts; ++i) {
    const float up = (static_cast<float>(i) + 0.5f) / static_cast<float>(parts);
    const float width = pointed ? spread * (1.1f - up) : spread * random.uniform(0.6f, 1);
    const float aside = pointed ? 0 : 0.5f * spread;
    const Vector3f centre(random.uniform(-aside, aside), random.uniform(-aside, aside), trunk + (height - trunk) * up);
    const float half = (height - trunk) / static_cast<float>(parts) * random.uniform(0.6f, 0.9f);
    add_bush(mesh, pose * centre, {width, width, half}, cards / parts, random);
  }
}

void add_tall_grass(Mesh& mesh, const Vector3f& centre, float radius, int blades, Random& random) {
  const Surface surface = surface_of(Material::foliage, random);
  for (int i = 0; i < blades; ++i) {
    const float angle = random.uniform(0, 6.2831853f), out = radius * std::sqrt(random.uniform(0, 1));
    const Vector3f foot = centre + out * Vector3f(std::cos(angle), std::sin(angle), 0);
    const float height = random.uniform(0.1f, 0.6f), width = random.uniform(0.05f, 0.3f);
    const Vector3f side(width * std::cos(3 * angle), width * std::sin(3 * angle), 0);
    const Vector3f lean(random.uniform(-0.2f, 0.2f), random.uniform(-0.2f, 0.2f), height);
    add_card(mesh, {foot - side, foot + side, foot + lean}, surface);
  }
}

}  // namespace calib::vehicle
