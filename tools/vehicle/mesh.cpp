#include "vehicle/mesh.hpp"

#include <cmath>

namespace calib::vehicle {
namespace {

using Eigen::Vector2f;
using Eigen::Vector3f;

/// Corners of an icosahedron subdivided once: 80 triangles of unit vectors.
std::vector<std::array<Vector3f, 3>> unit_sphere() {
  const float g = 0.5f * (1 + std::sqrt(5.f));
  const std::array<Vector3f, 12> corner{Vector3f{-1, g, 0}, {1, g, 0}, {-1, -g, 0}, {1, -g, 0},
                                        {0, -1, g},         {0, 1, g}, {0, -1, -g}, {0, 1, -g},
                                        {g, 0, -1},         {g, 0, 1}, {-g, 0, -1}, {-g, 0, 1}};
  constexpr std::array<std::array<int, 3>, 20> faces{{{0, 11, 5}, {0, 5, 1},  {0, 1, 7},   {0, 7, 10}, {0, 10, 11},
                                                      {1, 5, 9},  {5, 11, 4}, {11, 10, 2}, {10, 7, 6}, {7, 1, 8},
                                                      {3, 9, 4},  {3, 4, 2},  {3, 2, 6},   {3, 6, 8},  {3, 8, 9},
                                                      {4, 9, 5},  {2, 4, 11}, {6, 2, 10},  {8, 6, 7},  {9, 8, 1}}};
  std::vector<std::array<Vector3f, 3>> triangles;
  for (const auto& [i, j, k] : faces) {
    const Vector3f a = corner[i].normalized(), b = corner[j].normalized(), c = corner[k].normalized();
    const Vector3f ab = (a + b).normalized(), bc = (b + c).normalized(), ca = (c + a).normalized();
    triangles.insert(triangles.end(), {{a, ab, ca}, {ab, b, bc}, {ca, bc, c}, {ab, bc, ca}});
  }
  return triangles;
}

}  // namespace

void Mesh::add_triangle(const Corner& a, const Corner& b, const Corner& c, Surface surface) {
  triangles.push_back({{a, b, c}, surface});
}

void Mesh::add_quad(const std::array<Corner, 4>& corners, Surface surface) {
  add_triangle(corners[0], corners[1], corners[2], surface);
  add_triangle(corners[0], corners[2], corners[3], surface);
}

void Mesh::add_quad(const Vector3f& a, const Vector3f& b, const Vector3f& c, const Vector3f& d, Surface surface,
                    float u0, float v0) {
  const Vector3f along_u = (b - a).normalized();
  const Vector3f normal = (b - a).cross(d - a).normalized();
  const Vector3f along_v = normal.cross(along_u);
  const auto corner = [&](const Vector3f& p) { return Corner{p, u0 + along_u.dot(p - a), v0 + along_v.dot(p - a)}; };
  add_quad({corner(a), corner(b), corner(c), corner(d)}, surface);
}

void Mesh::add_box(const Eigen::Isometry3f& pose, const Vector3f& low, const Vector3f& high, Surface surface) {
  add_frustum(pose, low, high, low.head<2>(), high.head<2>(), surface);
}

void Mesh::add_frustum(const Eigen::Isometry3f& pose, const Vector3f& low, const Vector3f& high,
                       const Vector2f& top_low, const Vector2f& top_high, Surface surface) {
  const std::array<Vector3f, 4> bottom{
      pose * Vector3f(low.x(), low.y(), low.z()), pose * Vector3f(high.x(), low.y(), low.z()),
      pose * Vector3f(high.x(), high.y(), low.z()), pose * Vector3f(low.x(), high.y(), low.z())};
  const std::array<Vector3f, 4> top{
      pose * Vector3f(top_low.x(), top_low.y(), high.z()), pose * Vector3f(top_high.x(), top_low.y(), high.z()),
      pose * Vector3f(top_high.x(), top_high.y(), high.z()), pose * Vector3f(top_low.x(), top_high.y(), high.z())};
  for (int i = 0; i < 4; ++i) {
    const int next = (i + 1) % 4;
    // Sides start at different places of the texture so that they do not look alike.
    add_quad(bottom[i], bottom[next], top[next], top[i], surface, 7.3f * static_cast<float>(i), low.z());
  }
  add_quad(top[0], top[1], top[2], top[3], surface, low.x(), low.y());
  add_quad(bottom[3], bottom[2], bottom[1], bottom[0], surface, low.x(), low.y());
}

void Mesh::add_tube(const Eigen::Isometry3f& pose, float bottom_radius, float top_radius, float height, int sides,
                    Surface surface) {
  const auto ring = [&](int i, float radius, float z) -> Vector3f {
    const float angle = 6.2831853f * static_cast<float>(i % sides) / static_cast<float>(sides);
    return pose * Vector3f(radius * std::cos(angle), radius * std::sin(angle), z);
  };
  const float side_length = 6.2831853f * bottom_radius / static_cast<float>(sides);
  for (int i = 0; i < sides; ++i) {
    add_quad(ring(i, bottom_radius, 0), ring(i + 1, bottom_radius, 0), ring(i + 1, top_radius, height),
             ring(i, top_radius, height), surface, side_length * static_cast<float>(i), 0);
    add_triangle({pose * Vector3f(0, 0, height), 0, 0}, {ring(i, top_radius, height), top_radius, 0},
                 {ring(i + 1, top_radius, height), 0, top_radius}, surface);
  }
}

void Mesh::add_blob(const Vector3f& centre, const Vector3f& radii, float roughness, std::uint64_t seed,
                    Surface surface) {
  static const auto sphere = unit_sphere();
  for (const auto& face : sphere) {
    Triangle triangle{{}, surface};
    // The texture is laid on from the side that the face looks to, so that it is stretched by at most
    // sqrt(3).
    const Vector3f normal = (face[0] + face[1] + face[2]).cwiseAbs();
    int main_axis = 0;
    normal.maxCoeff(&main_axis);
    for (int i = 0; i < 3; ++i) {
      const Vector3f& direction = face[i];
      // A corner belongs to several faces: its displacement may depend on nothing but the corner.
      const auto key = [&](int axis) { return static_cast<std::uint64_t>(std::lround(1000 * direction[axis]) + 2000); };
      const float bump = 1 + roughness * (2 * unit(mix(seed, key(0), key(1), key(2))) - 1);
      const Vector3f p = centre + bump * radii.cwiseProduct(direction);
      triangle.corners[i] = {p, p[(main_axis + 1) % 3], p[(main_axis + 2) % 3]};
    }
    triangles.push_back(triangle);
  }
}

}  // namespace calib::vehicle
