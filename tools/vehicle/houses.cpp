#include "vehicle/houses.hpp"

#include "vehicle/furniture.hpp"

namespace calib::vehicle {
namespace {

using Eigen::Isometry3f;
using Eigen::Vector3f;

Surface surface_of(Material material, Random& random) { return {material, static_cast<std::uint32_t>(random.bits())}; }

/// Two slopes whose ridge runs along x, over the rectangle [0, width] x [0, depth] at height `eaves`.
void add_gable_roof(Mesh& mesh, const Isometry3f& pose, float width, float depth, float eaves, float rise, Surface roof,
                    Surface wall) {
  const float out = 0.4f, half = 0.5f * depth;
  const float drop = rise * out / half;  // the slope goes on past the wall
  const auto at = [&](float x, float y, float z) -> Vector3f { return pose * Vector3f(x, y, eaves + z); };
  const Vector3f ridge0 = at(-out, half, rise), ridge1 = at(width + out, half, rise);
  const Vector3f front0 = at(-out, -out, -drop), front1 = at(width + out, -out, -drop);
  const Vector3f back0 = at(-out, depth + out, -drop), back1 = at(width + out, depth + out, -drop);
  mesh.add_quad(front0, front1, ridge1, ridge0, roof);
  mesh.add_quad(back1, back0, ridge0, ridge1, roof);
  // From below, so that the overhang can be seen.
  mesh.add_quad(front1, front0, ridge0, ridge1, roof);
  mesh.add_quad(back0, back1, ridge1, ridge0, roof);
  mesh.add_triangle({at(width, 0, 0), 0, 0}, {at(width, depth, 0), depth, 0}, {at(width, half, rise), half, rise},
                    wall);
  mesh.add_triangle({at(0, depth, 0), 0, 0}, {at(0, 0, 0), depth, 0}, {at(0, half, rise), half, rise}, wall);
}

void add_roof(Mesh& mesh, const Isometry3f& pose, float width, float depth, float height, Surface wall,
              Random& random) {
  const Surface roof = surface_of(Material::roof, random), stone = surface_of(Material::plain, random);
  if (random.chance(0.5f)) {
    const float rise = depth * random.uniform(0.25f, 0.4f);
    add_gable_roof(mesh, pose, width, depth, height, rise, roof, {Material::plain, wall.seed});
    const float x = random.uniform(0.2f, 0.7f) * width;
    mesh.add_box(pose, {x, 0.3f * depth, height}, {x + 0.7f, 0.3f * depth + 0.6f, height + rise + 0.8f}, stone);
  } else {
    const float out = random.uniform(0.15f, 0.5f);
    mesh.add_box(pose, {-0.02f, -out, height - 0.45f}, {width + 0.02f, depth, height + 0.1f}, stone);
    mesh.add_box(pose, {0, 0, height + 0.1f}, {width, 0.25f, height + random.uniform(0.5f, 1)}, wall);
  }
}

void add_balconies(Mesh& mesh, const Isometry3f& pose, float width, float height, Random& random) {
  const Surface slab = surface_of(Material::plain, random), rail = surface_of(Material::metal, random);
  const float reach = random.uniform(0.9f, 1.4f), length = random.uniform(2, 3.4f);
  const float x = random.uniform(0.4f, width - length - 0.4f);
  for (float z = 3; z < height - 2.5f; z += 3) {
    mesh.add_box(pose, {x, -reach, z}, {x + length, 0, z + 0.16f}, slab);
    mesh.add_box(pose, {x, -reach, z + 0.25f}, {x + length, -reach + 0.05f, z + 1}, rail);
    for (const float end : {x, x + length - 0.05f})
      mesh.add_box(pose, {end, -reach + 0.05f, z + 0.25f}, {end + 0.05f, 0, z + 1}, rail);
  }
}

/// Awning, shop sign, steps: what is at the height that the LiDAR sees.
void add_ground_floor(Mesh& mesh, const Isometry3f& pose, float width, Random& random) {
  if (random.chance(0.45f)) {
    const float low = random.uniform(2.2f, 2.5f), reach = random.uniform(1, 1.8f);
    const float from = random.uniform(0.3f, 0.25f * width), to = random.uniform(0.75f * width, width - 0.3f);
    const Surface cloth = surface_of(Material::cloth, random);
    mesh.add_frustum(pose, {from, -reach, low}, {to, 0, low + 0.7f}, {from, -0.2f}, {to, 0}, cloth);
  }
  if (random.chance(0.5f)) {
    const float x = random.uniform(0.2f, 0.9f) * width, z = random.uniform(2.3f, 3);
    mesh.add_box(pose, {x, -1.1f, z}, {x + 0.12f, -0.1f, z + random.uniform(0.5f, 1)},
                 surface_of(Material::sign, random));
  }
  const float door = random.uniform(0.15f, 0.6f) * width;
  const Surface stone = surface_of(Material::plain, random);
  mesh.add_box(pose, {door, -0.7f, 0}, {door + 1.6f, 0, 0.3f}, stone);
  mesh.add_box(pose, {door, -0.35f, 0.3f}, {door + 1.6f, 0, 0.46f}, stone);
  mesh.add_box(pose, {door + 0.3f, -0.06f, 0.46f}, {door + 1.3f, 0, 2.5f}, surface_of(Material::paint, random));
  mesh.add_box(pose, {0, -0.09f, 0}, {width, 0, random.uniform(0.35f, 0.7f)}, stone);
}

}  // namespace

void add_house(Mesh& mesh, const Isometry3f& pose, float width, Random& random) {
  const float depth = random.uniform(9, 12), height = random.uniform(5.5f, 15);
  const Surface wall = surface_of(Material::facade, random);
  mesh.add_box(pose, {0, 0, 0}, {width, depth, height}, wall);
  add_roof(mesh, pose, width, depth, height, wall, random);
  add_ground_floor(mesh, pose, width, random);
  const int extra = random.below(3);
  if (extra == 0 && width > 5) add_balconies(mesh, pose, width, height, random);
  if (extra == 1 && width > 5) {
    const float x = random.uniform(0.5f, width - 3.5f), bottom = random.chance(0.5f) ? 0 : 2.8f;
    mesh.add_box(pose, {x, -random.uniform(0.5f, 0.9f), bottom}, {x + 2.8f, 0, 0.85f * height}, wall);
  }
  if (random.chance(0.5f))
    mesh.add_tube(pose * Eigen::Translation3f(width - 0.25f, -0.1f, 0), 0.06f, 0.06f, height - 0.3f, 5,
                  surface_of(Material::metal, random));
}

void add_garden(Mesh& mesh, const Isometry3f& pose, float width, Random& random) {
  const bool hedge = random.chance(0.5f);
  const float gate = random.uniform(0.2f, 0.6f) * width, height = random.uniform(0.7f, 1.5f);
  const Surface fence = surface_of(hedge ? Material::leaves : Material::plain, random);
  const float thick = hedge ? 0.7f : 0.25f;
  mesh.add_box(pose, {0, 0, 0}, {gate, thick, height}, fence);
  mesh.add_box(pose, {gate + 1.3f, 0, 0}, {width, thick, height}, fence);
  const Surface post = surface_of(Material::plain, random);
  for (const float x : {gate - 0.15f, gate + 1.15f})
    mesh.add_box(pose, {x, -0.05f, 0}, {x + 0.3f, 0.3f, height + 0.4f}, post);
  for (float x = 1.5f; x < width - 1; x += random.uniform(2.5f, 5))
    add_tree(mesh, pose * Eigen::Translation3f(x, random.uniform(2, 4), 0), random);
  add_house(mesh, pose * Eigen::Translation3f(1, random.uniform(5, 8), 0), width - 2, random);
}

}  // namespace calib::vehicle
