#include "vehicle/furniture.hpp"

namespace calib::vehicle {
namespace {

using Eigen::Isometry3f;
using Eigen::Translation3f;
using Eigen::Vector2f;
using Eigen::Vector3f;

Surface surface_of(Material material, Random& random) { return {material, static_cast<std::uint32_t>(random.bits())}; }

/// A box on the ground, centred on (x, y) of the pose.
void add_block(Mesh& mesh, const Isometry3f& pose, const Vector2f& centre, const Vector3f& size, float bottom,
               Surface surface) {
  const Vector2f half = 0.5f * size.head<2>();
  mesh.add_box(pose, {centre.x() - half.x(), centre.y() - half.y(), bottom},
               {centre.x() + half.x(), centre.y() + half.y(), bottom + size.z()}, surface);
}

/// A cabin with glass all round and a painted roof; `low` and `high` are its foot, `inset_x` and `inset_y`
/// say how much narrower its top is (front and rear; sides).
void add_cabin(Mesh& mesh, const Isometry3f& pose, const Vector3f& low, const Vector3f& high, const Vector2f& inset_x,
               float inset_y, Surface paint, Surface glass) {
  const Vector2f top_low(low.x() + inset_x[1], low.y() + inset_y), top_high(high.x() - inset_x[0], high.y() - inset_y);
  mesh.add_frustum(pose, low, high, top_low, top_high, glass);
  mesh.add_box(pose, {top_low.x(), top_low.y(), high.z()}, {top_high.x(), top_high.y(), high.z() + 0.07f}, paint);
}

void add_wheels(Mesh& mesh, const Isometry3f& pose, float axle, float half_width, float radius, Random& random) {
  const Surface rubber = surface_of(Material::rubber, random);
  for (const float x : {-axle, axle})
    for (const float side : {-1.f, 1.f}) {
      Isometry3f hub = pose * Translation3f(x, side * (half_width - 0.22f), radius);
      hub.rotate(Eigen::AngleAxisf(-side * 1.5707963f, Vector3f::UnitX()));
      mesh.add_tube(hub, radius, radius, 0.24f, 8, rubber);
    }
}

void add_lights(Mesh& mesh, const Isometry3f& pose, float half_length, float half_width, float height, Random& random) {
  const Surface lamp = surface_of(Material::sign, random);
  for (const float end : {-half_length, half_length})
    for (const float side : {-1.f, 1.f})
      add_block(mesh, pose, {end, side * (half_width - 0.25f)}, {0.06f, 0.34f, 0.16f}, height, lamp);
}

void add_ground_shadow(Mesh& mesh, const Isometry3f& pose, float half_length, float half_width, Random& random) {
  const float x = half_length + 0.15f, y = half_width + 0.15f;
  mesh.add_quad(pose * Vector3f(-x, -y, 0.012f), pose * Vector3f(x, -y, 0.012f), pose * Vector3f(x, y, 0.012f),
                pose * Vector3f(-x, y, 0.012f), surface_of(Material::shadow, random));
}

}  // namespace

void add_tree(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const float height = random.uniform(2.2f, 3.2f), radius = random.uniform(0.12f, 0.24f);
  mesh.add_tube(pose, radius, 0.7f * radius, height + 0.8f, 6, surface_of(Material::bark, random));
  const Surface leaves = surface_of(Material::leaves, random);
  const float size = random.uniform(0.8f, 1.3f);
  const int blobs = 3 + random.below(3);
  for (int i = 0; i < blobs; ++i) {
    const Vector3f centre(random.uniform(-1, 1) * size, random.uniform(-0.9f, 0.9f) * size,
                          height + size * random.uniform(0.7f, 2.2f));
    const Vector3f radii(size * random.uniform(0.8f, 1.3f), size * random.uniform(0.8f, 1.3f),
                         size * random.uniform(0.7f, 1.1f));
    // Blobs are laid out in the mesh's own frame: only their centre follows the pose.
    mesh.add_blob(pose * centre, radii, 0.22f, random.bits(), leaves);
  }
  add_block(mesh, pose, {0, 0}, {1.2f, 1.2f, 0.06f}, 0, surface_of(Material::earth, random));
}

void add_lamp_post(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const float height = random.uniform(5, 7.5f), reach = random.uniform(1.2f, 2.2f);
  const Surface metal = surface_of(Material::metal, random);
  mesh.add_tube(pose, 0.1f, 0.06f, height, 6, metal);
  mesh.add_tube(pose, 0.16f, 0.16f, 0.9f, 6, metal);
  mesh.add_box(pose, {-0.04f, -reach, height - 0.1f}, {0.04f, 0, height}, metal);
  mesh.add_box(pose, {-0.15f, -reach - 0.5f, height - 0.16f}, {0.15f, -reach + 0.2f, height},
               surface_of(Material::plain, random));
  if (random.chance(0.5f))
    mesh.add_box(pose, {-0.05f, -0.75f, 2.4f}, {0.05f, -0.12f, 3.5f}, surface_of(Material::sign, random));
}

void add_traffic_sign(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const float height = random.uniform(2, 2.5f);
  mesh.add_tube(pose, 0.035f, 0.035f, height + 0.6f, 5, surface_of(Material::metal, random));
  // Faces along the street, both ways.
  const float width = random.uniform(0.5f, 0.9f);
  mesh.add_box(pose, {-0.06f, -0.5f * width, height}, {-0.04f, 0.5f * width, height + random.uniform(0.5f, 0.9f)},
               surface_of(Material::sign, random));
  if (random.chance(0.4f))
    mesh.add_box(pose, {-0.06f, -0.3f, height - 0.45f}, {-0.04f, 0.3f, height - 0.08f},
                 surface_of(Material::sign, random));
}

void add_shelter(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const Surface metal = surface_of(Material::metal, random), panel = surface_of(Material::cloth, random);
  for (const float x : {0.1f, 3.9f})
    for (const float y : {0.1f, 1.3f}) mesh.add_tube(pose * Translation3f(x, y, 0), 0.05f, 0.05f, 2.35f, 4, metal);
  mesh.add_box(pose, {-0.1f, -0.2f, 2.35f}, {4.1f, 1.5f, 2.5f}, metal);
  mesh.add_box(pose, {0.2f, 1.3f, 0.3f}, {2.4f, 1.35f, 2.1f}, panel);
  mesh.add_box(pose, {3.85f, 0.2f, 0.25f}, {3.95f, 1.25f, 2.05f}, surface_of(Material::sign, random));
  mesh.add_box(pose, {0.4f, 0.85f, 0.42f}, {2.6f, 1.2f, 0.5f}, panel);
}

void add_bollards(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const Surface surface = surface_of(random.chance(0.5f) ? Material::metal : Material::plain, random);
  const int count = 2 + random.below(2);
  for (int i = 0; i < count; ++i)
    mesh.add_tube(pose * Translation3f(1.1f * static_cast<float>(i), -0.2f, 0), 0.09f, 0.07f, 0.95f, 6, surface);
}

void add_box_furniture(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const Surface surface = surface_of(random.chance(0.5f) ? Material::paint : Material::plain, random);
  switch (random.below(5)) {
    case 0:
      add_block(mesh, pose, {0, 0}, {1.7f, 0.45f, 0.08f}, 0.4f, surface);
      add_block(mesh, pose, {0, 0.25f}, {1.7f, 0.06f, 0.4f}, 0.5f, surface);
      for (const float x : {-0.7f, 0.7f}) add_block(mesh, pose, {x, 0}, {0.08f, 0.4f, 0.4f}, 0, surface);
      break;
    case 1:
      mesh.add_tube(pose, 0.28f, 0.32f, 0.95f, 8, surface);
      break;
    case 2:
      add_block(mesh, pose, {0, 0}, {0.35f, 0.3f, 0.8f}, 0.6f, surface);
      add_block(mesh, pose, {0, 0}, {0.12f, 0.12f, 0.6f}, 0, surface);
      break;
    case 3:
      add_block(mesh, pose, {0, 0}, {1.2f, 0.6f, 0.55f}, 0, surface);
      mesh.add_blob(pose * Vector3f(0, 0, 0.75f), {0.5f, 0.4f, 0.4f}, 0.25f, random.bits(),
                    surface_of(Material::leaves, random));
      break;
    default:
      add_block(mesh, pose, {0, 0.2f}, {random.uniform(0.8f, 1.8f), 0.4f, random.uniform(1, 1.4f)}, 0, surface);
  }
}

void add_person(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const float height = random.uniform(1.55f, 1.9f);
  const Surface trousers = surface_of(Material::cloth, random), coat = surface_of(Material::cloth, random);
  const float stride = random.uniform(0.05f, 0.3f);
  add_block(mesh, pose, {stride, 0.11f}, {0.17f, 0.17f, 0.47f * height}, 0, trousers);
  add_block(mesh, pose, {-stride, -0.11f}, {0.17f, 0.17f, 0.47f * height}, 0, trousers);
  mesh.add_frustum(pose, {-0.14f, -0.2f, 0.45f * height}, {0.14f, 0.2f, 0.85f * height}, {-0.12f, -0.24f},
                   {0.12f, 0.24f}, coat);
  for (const float side : {-1.f, 1.f})
    add_block(mesh, pose, {side * stride, 0.29f * side}, {0.12f, 0.1f, 0.38f * height}, 0.46f * height, coat);
  mesh.add_blob(pose * Vector3f(0, 0, 0.92f * height), {0.1f, 0.1f, 0.08f * height}, 0.05f, random.bits(),
                surface_of(Material::plain, random));
}

void add_car(Mesh& mesh, const Isometry3f& pose, Random& random) {
  const Surface paint = surface_of(Material::paint, random), glass = surface_of(Material::glass, random);
  const int kind = random.below(8);
  const bool lorry = kind == 0, van = kind == 1;
  const float half_length = lorry ? 3.2f : van ? 2.5f : random.uniform(1.9f, 2.35f);
  const float half_width = lorry ? 1.1f : van ? 0.98f : random.uniform(0.83f, 0.92f);
  const float belt = lorry ? 1.1f : random.uniform(0.78f, 1.f), bottom = 0.22f;
  add_ground_shadow(mesh, pose, half_length, half_width, random);
  add_wheels(mesh, pose, 0.62f * half_length, half_width, lorry ? 0.42f : 0.33f, random);
  add_lights(mesh, pose, half_length, half_width, belt - 0.3f, random);
  if (lorry) {
    add_cabin(mesh, pose, {half_length - 1.4f, -half_width, belt}, {half_length, half_width, 2.1f}, {0.25f, 0}, 0.06f,
              paint, glass);
    mesh.add_box(pose, {half_length - 1.4f, -half_width, bottom}, {half_length, half_width, belt}, paint);
    mesh.add_box(pose, {-half_length, -half_width, 0.6f}, {half_length - 1.5f, half_width, random.uniform(2.4f, 3)},
                 surface_of(Material::plain, random));
    return;
  }
  // Lower body, then bumpers that stick out, then the cabin.
  mesh.add_frustum(pose, {-half_length, -half_width, bottom}, {half_length, half_width, belt},
                   {-half_length + 0.12f, -half_width + 0.06f}, {half_length - 0.2f, half_width - 0.06f}, paint);
  const Surface plastic = surface_of(Material::rubber, random);
  for (const float end : {-half_length, half_length})
    add_block(mesh, pose, {end, 0}, {0.16f, 1.8f * half_width, 0.2f}, 0.3f, plastic);
  const float roof = van ? random.uniform(1.85f, 2.3f) : belt + random.uniform(0.48f, 0.72f);
  const float front = van ? half_length - 0.7f : half_length - random.uniform(0.95f, 1.2f);
  const float rear = van || kind < 5 ? -half_length + 0.12f : -half_length + random.uniform(0.6f, 0.8f);
  add_cabin(mesh, pose, {rear, -half_width + 0.07f, belt}, {front, half_width - 0.07f, roof},
            {random.uniform(0.5f, 0.75f), van ? 0.05f : random.uniform(0.2f, 0.5f)}, 0.14f, paint, van ? paint : glass);
  for (const float side : {-1.f, 1.f})
    add_block(mesh, pose, {front - 0.35f, side * (half_width + 0.06f)}, {0.1f, 0.16f, 0.12f}, belt, paint);
}

}  // namespace calib::vehicle
