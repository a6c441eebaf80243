#include "edges.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>
#include <utility>
#include <vector>

#include "calib/mutual_information.hpp"
#include "calib/search.hpp"
#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
#include "vehicle/random.hpp"

using namespace calib;

namespace {

constexpr int columns = 201, rings = 41;
constexpr double azimuth_step_rad = 0.2 * radians_per_degree, ring_step_rad = 0.4 * radians_per_degree;

/// What is measured towards a column and a ring of a LiDAR whose middle ray goes forward; NaN: nothing.
template <typename RangeAt>
std::vector<Eigen::Vector3f> scan_of(const RangeAt& range_at) {
  std::vector<Eigen::Vector3f> points;
  for (int ring = 0; ring < rings; ++ring)
    for (int column = 0; column < columns; ++column) {
      const double left = (columns / 2 - column) * azimuth_step_rad, up = (rings / 2 - ring) * ring_step_rad;
      const float range = range_at(column, ring);
      if (!std::isnan(range))
        points.push_back(
            range *
            Eigen::Vector3d(std::cos(up) * std::cos(left), std::cos(up) * std::sin(left), std::sin(up)).cast<float>());
    }
  return points;
}

/// The camera's axes: x to the right, y down, z forward, of a LiDAR's x forward, y to the left, z up.
RigidTransform looking_forward() {
  RigidTransform T = RigidTransform::Identity();
  T.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  return T;
}

/// Columns of the points at edges.
std::set<int> edge_columns(const std::vector<Eigen::Vector3f>& points) {
  std::set<int> found;
  for (const std::size_t i : range_edges(points, looking_forward()))
    found.insert(columns / 2 -
                 static_cast<int>(std::lround(std::atan2(points[i].y(), points[i].x()) / azimuth_step_rad)));
  return found;
}

bool on_box(int column, int ring) { return column >= 80 && column <= 120 && ring >= 15 && ring <= 25; }

BearingGrid pinhole(int width, int height, float focal) {
  return {width, height, focal, focal, static_cast<float>(width) / 2, static_cast<float>(height) / 2, 0};
}

FeatureSet with_edges(test::SimulatedDrive& drive, int index, const RigidTransform& motion) {
  return test::require_ok(
      make_features(drive.pair(index, motion), drive.depth(index), drive.camera(), drive.T_camera_lidar(), {}));
}

Objective edges_alone() {
  Objective objective;
  objective.terms[0] = {FeaturePair::edges, 1, 8, true};
  return objective;
}

}  // namespace

TEST_CASE("the edges of a scan are the left and right sides of what stands in front") {
  CHECK(edge_columns(scan_of([](int column, int ring) { return on_box(column, ring) ? 10.F : 20.F; })) ==
        std::set{80, 120});
  // Not what is behind something, nor what is oblique: a ground of which each ring is further than the one below.
  CHECK(edge_columns(scan_of([](int, int ring) { return 5 + 80.F / static_cast<float>(ring + 1); })).empty());
  // What ends before the sky ends too, but for where the scan itself does.
  CHECK(edge_columns(scan_of([](int column, int ring) {
          return on_box(column, ring) ? 10 : ring < 30 && column > 40 && column < 160 ? NAN : 20.F;
        })) == std::set{40, 80, 120, 160});
  CHECK(range_edges({}, looking_forward()).empty());
}

TEST_CASE("edges do not depend on the order of the points, nor on where the LiDAR's axes point") {
  auto points = scan_of([](int column, int ring) { return on_box(column, ring) ? 10.F : 20.F; });
  const auto positions = [](const std::vector<Eigen::Vector3f>& from, const RigidTransform& T_camera_points) {
    std::set<std::size_t> found;
    for (const std::size_t i : range_edges(from, T_camera_points)) found.insert(i);
    return found;
  };
  const auto original = positions(points, looking_forward());
  CHECK(original.size() == 2 * 11);
  std::vector<Eigen::Vector3f> reversed(points.rbegin(), points.rend());
  std::set<std::size_t> same;
  for (const std::size_t i : positions(reversed, looking_forward())) same.insert(points.size() - 1 - i);
  CHECK(same == original);
  const RigidTransform turned = test::knock(70, 20, 110);
  for (Eigen::Vector3f& point : points) point = turned.cast<float>() * point;
  CHECK(positions(points, looking_forward() * turned.inverse()) == original);
}

TEST_CASE("contrast is that between left and right, ranked within its tile") {
  const BearingGrid grid = pinhole(640, 192, 360);
  std::vector<float> posts(grid.pixels()), beams(grid.pixels());
  for (int v = 0; v < grid.height; ++v)
    for (int u = 0; u < grid.width; ++u) {
      posts[static_cast<std::size_t>(v) * grid.width + u] = static_cast<float>(u % 40 / 20) * 100;
      beams[static_cast<std::size_t>(v) * grid.width + u] = static_cast<float>(v % 40 / 20) * 100;
    }
  const ContrastPlane plane = contrast_of(posts, grid);
  CHECK(plane.cell_columns == 1);
  CHECK(plane.cell_rows == 1);
  REQUIRE(plane.rank.size() == grid.pixels());
  for (int u = 0; u < grid.width; ++u) {
    const int rank = plane.rank[static_cast<std::size_t>(90) * plane.width + u];
    if (u % 20 == 0 && u > 0) CHECK(rank > 200);
    if (u % 20 == 10) CHECK(rank < 170);
  }
  const ContrastPlane flat = contrast_of(beams, grid);
  CHECK(std::ranges::all_of(flat.rank, [](std::uint8_t rank) { return rank == 0; }));
  // Twice the resolution, the same cells.
  const ContrastPlane fine = contrast_of(std::vector<float>(4 * grid.pixels(), 1), pinhole(1280, 384, 720));
  CHECK(fine.cell_columns == 2);
  CHECK(fine.width == 640);
  // Where the camera sees nothing there is no contrast, nor next to it.
  std::fill_n(posts.begin(), grid.pixels() / 2, std::numeric_limits<float>::quiet_NaN());
  const ContrastPlane half = contrast_of(posts, grid);
  CHECK(half.rank.front() == FeatureSet::none);
  CHECK(half.rank[static_cast<std::size_t>(97) * half.width + 320] == FeatureSet::none);
  CHECK(half.rank[static_cast<std::size_t>(110) * half.width + 320] != FeatureSet::none);
  CHECK(contrast_of({}, grid).rank.empty());
}

TEST_CASE("the score of edges is highest at the extrinsic, and 1 without edges") {
  test::SimulatedDrive drive(41, 1242, 375, {.azimuth_step_deg = 0.2, .field_of_view_deg = 110});
  std::vector<FeatureSet> frames;
  for (int i = 0; i < 6; ++i) frames.push_back(with_edges(drive, i, RigidTransform::Identity()));
  const auto all = test::pointers(frames);
  const Score at_truth = mean_score(all, drive.T_camera_lidar(), edges_alone());
  CHECK(at_truth.points > 6 * min_scored_edges);
  CHECK(at_truth.value > 1.05);
  CHECK(at_truth.value < 1.5);
  for (int axis = 0; axis < 3; ++axis)
    for (const int side : {-1, 1}) {
      CAPTURE(axis, side);
      const Vector6 moved = Vector6::Unit(axis) * side * 1.5 * radians_per_degree;
      CHECK(mean_score(all, drive.T_camera_lidar() * perturbation(moved), edges_alone()).value < at_truth.value);
    }
  FeatureSet without = frames[0];
  without.edge_x.clear(), without.edge_y.clear(), without.edge_z.clear();
  CHECK(score(without, drive.T_camera_lidar(), edges_alone()).value == 1);
  // The other terms do not notice.
  Objective others = drift_objective(true);
  others.count = 2;
  CHECK(score(without, drive.T_camera_lidar(), others).value == score(frames[0], drive.T_camera_lidar(), others).value);
  // A frame about another extrinsic keeps its edges.
  const FeatureSet about = frames[0].about(drive.T_camera_lidar(), {});
  CHECK(score(about, drive.T_camera_lidar(), edges_alone()).value ==
        score(frames[0], drive.T_camera_lidar(), edges_alone()).value);
}

TEST_CASE("a cloud of which all points lie in one direction takes no longer than any other") {
  vehicle::Random random(21);
  std::vector<Eigen::Vector3f> points;
  for (int i = 0; i < 200'000; ++i)
    points.emplace_back(10 + random.uniform(0, 30), 1e-3F * random.uniform(-1, 1), 1e-3F * random.uniform(-1, 1));
  CHECK(range_edges(points, looking_forward()).empty());  // would take minutes if each were compared with each
}
