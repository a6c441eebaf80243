#include "vehicle/street.hpp"

#include <algorithm>
#include <array>
#include <cmath>

#include "vehicle/furniture.hpp"
#include "vehicle/houses.hpp"

namespace calib::vehicle {
namespace {

constexpr std::uint32_t street_surface_seed = 7;  // one road, wherever it is: no seams between blocks

enum Purpose : std::uint64_t { phases, crossing, lots, kerbside };

/// Places in a block: a frame whose x axis runs along the house line with the street on its right hand (-y)
/// side.
class Side {
 public:
  Side(const Street& street, int block, bool left) : street_(street), start_(block * Street::block_m), left_(left) {
    T_block_world_ = street.pose_at(start_, 0).inverse();
  }
  /// `along` metres from the begin of the block as seen walking with the street on the right; `out` from the
  /// centre.
  [[nodiscard]] Eigen::Isometry3f at(double along, double out) const {
    const double x = start_ + (left_ ? along : Street::block_m - along);
    Eigen::Isometry3d pose = T_block_world_ * street_.pose_at(x, left_ ? out : -out);
    if (!left_) pose.rotate(Eigen::AngleAxisd(M_PI, Eigen::Vector3d::UnitZ()));
    return pose.cast<float>();
  }

 private:
  const Street& street_;
  double start_;
  bool left_;
  Eigen::Isometry3d T_block_world_;
};

/// The ground of a block: strips along the street.
void add_ground(Mesh& mesh, const Street& street, int block) {
  struct Line {
    float out, height;
  };
  const Surface road{Material::road, street_surface_seed}, asphalt{Material::asphalt, street_surface_seed + 1},
      kerb{Material::kerb, street_surface_seed + 2}, paving{Material::paving, street_surface_seed + 3},
      earth{Material::earth, street_surface_seed + 4};
  constexpr float h = Street::kerb_height_m;
  // From the centre outwards; strip i lies between line i and i + 1.
  const std::array<Line, 6> raised{
      {{0, 0}, {3, 0}, {Street::kerb_m, 0}, {Street::kerb_m, h}, {9, h}, {Street::lot_depth_m, h}}};
  const std::array<Surface, 5> raised_surfaces{road, road, kerb, paving, earth};
  const std::array<Surface, 5> crossing_surfaces{road, road, asphalt, asphalt, asphalt};

  const double start = block * Street::block_m;
  const Eigen::Isometry3d T_block_world = street.pose_at(start, 0).inverse();
  const bool crossing = street.begins_with_crossing(block);
  constexpr double step = 2;
  for (double x = 0; x < Street::block_m; x += step) {
    const bool flat = crossing && x + step <= Street::crossing_m + 1;
    const auto& surfaces = flat ? crossing_surfaces : raised_surfaces;
    const auto corner = [&](double at, float d, float height) {
      const Eigen::Vector3d p = T_block_world * street.pose_at(start + at, d) * Eigen::Vector3d(0, 0, height);
      return Corner{p.cast<float>(), static_cast<float>(at), d};
    };
    for (std::size_t i = 0; i + 1 < raised.size(); ++i) {
      const Line inner{raised[i].out, flat ? 0 : raised[i].height},
          outer{raised[i + 1].out, flat ? 0 : raised[i + 1].height};
      if (inner.out == outer.out && inner.height == outer.height) continue;
      // A kerb has no width: its texture runs up its face.
      const float rise = outer.height - inner.height;
      auto left_outer_near = corner(x, outer.out, outer.height),
           left_outer_far = corner(x + step, outer.out, outer.height);
      auto right_outer_near = corner(x, -outer.out, outer.height),
           right_outer_far = corner(x + step, -outer.out, outer.height);
      for (Corner* c : {&left_outer_near, &left_outer_far, &right_outer_near, &right_outer_far}) c->v += rise;
      mesh.add_quad({corner(x, inner.out, inner.height), corner(x + step, inner.out, inner.height), left_outer_far,
                     left_outer_near},
                    surfaces[i]);
      mesh.add_quad({corner(x + step, -inner.out, inner.height), corner(x, -inner.out, inner.height), right_outer_near,
                     right_outer_far},
                    surfaces[i]);
    }
  }
}

/// The ends of the pavement where a cross street begins, as steps that face it.
void add_crossing(Mesh& mesh, const Side& side, std::uint64_t seed, bool left) {
  const Surface kerb{Material::kerb, street_surface_seed + 2};
  // `along` of the two edges of the cross street, in walking order.
  constexpr float length = static_cast<float>(Street::block_m), edge = Street::crossing_m + 1;
  const float far_edge = left ? edge : length - edge;
  const Eigen::Isometry3f corner = side.at(far_edge, Street::kerb_m);
  const float sign = left ? 1.f : -1.f;
  // A kerb along the side street, and a wide one on its other side.
  const auto slab = [&](const Eigen::Isometry3f& pose, float from, float to) {
    mesh.add_box(pose, {std::min(from, to), 0.1f, 0}, {std::max(from, to), 45, Street::kerb_height_m + 0.02f}, kerb);
  };
  slab(corner, -0.3f * sign, 0);
  const Eigen::Isometry3f near_corner = side.at(left ? 0 : length, Street::kerb_m);
  slab(near_corner, 0, 0.3f * sign);
  // What closes the view down the side street.
  Random random(seed);
  const float middle = left ? 0.f : length - edge;
  add_house(mesh, side.at(middle - 2, 48), edge + 4, random);
}

/// Houses, gardens and gaps, from one end of a block to the other.
void add_lots(Mesh& mesh, const Side& side, std::uint64_t seed, float from, float to) {
  Random random(seed);
  for (float at = from; to - at > 5;) {
    float width = random.uniform(8, 15);
    if (to - at - width < 6) width = to - at;  // no sliver at the end
    if (random.chance(0.18f)) {
      add_garden(mesh, side.at(at, Street::house_line_m), width, random);
    } else {
      const float set_back = random.chance(0.4f) ? random.uniform(0.3f, 2.5f) : 0;
      const float gap = random.chance(0.3f) ? random.uniform(1, 2.5f) : 0;
      add_house(mesh, side.at(at, Street::house_line_m + set_back), width - gap, random);
    }
    at += width;
  }
}

/// What stands between the kerb and the houses, and the cars parked beside it.
void add_kerbside(Mesh& mesh, const Side& side, std::uint64_t seed, float from, float to) {
  Random random(seed);
  const bool trees = random.chance(0.55f), lamps = !trees || random.chance(0.5f);
  for (float at = from + random.uniform(1, 4); at < to - 1; at += random.uniform(2.2f, 5)) {
    const Eigen::Isometry3f pose =
        side.at(at, Street::kerb_m + random.uniform(0.5f, 0.9f)) * Eigen::Translation3f(0, 0, Street::kerb_height_m);
    const int choice = random.below(12);
    if (choice < 3 && trees)
      add_tree(mesh, pose, random);
    else if (choice < 4 && lamps)
      add_lamp_post(mesh, pose, random);
    else if (choice < 6)
      add_traffic_sign(mesh, pose, random);
    else if (choice < 7 && to - at > 6)
      add_shelter(mesh, pose, random);
    else if (choice < 9)
      add_box_furniture(mesh, pose, random);
    else if (choice < 11)
      add_bollards(mesh, pose, random);
    else
      add_person(mesh, pose, random);
  }
  for (float at = from + random.uniform(2, 7); at < to - 3; at += random.uniform(5.4f, 7)) {
    if (!random.chance(0.6f)) continue;
    const float heading = random.chance(0.5f) ? 0.f : static_cast<float>(M_PI);
    Eigen::Isometry3f pose = side.at(at, Street::kerb_m - 1.15 + random.uniform(-0.15f, 0.1f));
    pose.rotate(Eigen::AngleAxisf(heading + random.uniform(-0.04f, 0.04f), Eigen::Vector3f::UnitZ()));
    add_car(mesh, pose, random);
  }
}

}  // namespace

Street::Street(std::uint64_t seed) : seed_(seed) {
  Random random(mix(seed, Purpose::phases));
  for (double& phase : phases_) phase = random.uniform(0, 6.2831853f);
}

Eigen::Vector3d Street::centre(double x) const {
  return {x, 6 * std::sin(2 * M_PI / 220 * x + phases_[0]) + 25 * std::sin(2 * M_PI / 900 * x + phases_[1]),
          0.8 * std::sin(2 * M_PI / 310 * x + phases_[2])};
}

Eigen::Isometry3d Street::pose_at(double x, double d) const {
  constexpr double h = 0.5;
  const Eigen::Vector3d along = (centre(x + h) - centre(x - h)).normalized();
  const Eigen::Vector3d left = Eigen::Vector3d::UnitZ().cross(along).normalized();
  Eigen::Isometry3d pose;
  pose.linear() << along, left, along.cross(left);
  pose.translation() = centre(x) + d * left;
  return pose;
}

bool Street::begins_with_crossing(int block) const { return mix(seed_, Purpose::crossing, block) % 3 == 0; }

Mesh Street::block(int index) const {
  Mesh mesh;
  add_ground(mesh, *this, index);
  const bool crossing = begins_with_crossing(index);
  const float length = static_cast<float>(block_m), open = crossing ? crossing_m + 1 : 0;
  for (const bool left : {true, false}) {
    const Side side(*this, index, left);
    // Walking with the street on the right, a crossing comes first on the left side and last on the other.
    const float from = left ? open : 0, to = left ? length : length - open;
    if (crossing) add_crossing(mesh, side, mix(seed_, Purpose::crossing, index, left), left);
    add_lots(mesh, side, mix(seed_, Purpose::lots, index, left), from, to);
    add_kerbside(mesh, side, mix(seed_, Purpose::kerbside, index, left), from, to);
  }
  return mesh;
}

}  // namespace calib::vehicle
