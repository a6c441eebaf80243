#include "calib/features.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <tuple>
#include <vector>

#include "ranks.hpp"
#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
#include "vehicle/random.hpp"

using namespace calib;

namespace {

/// Length of the ray through a pixel that reaches one metre forward.
double ray_length(const Camera& camera, std::size_t pixel) {
  const auto u = static_cast<double>(pixel % camera.width()), v = static_cast<double>(pixel / camera.width());
  return std::hypot(1, (u - camera.cx()) / camera.fx(), (v - camera.cy()) / camera.fy());
}

LidarScan random_points(vehicle::Random& random, int count, float reach_m) {
  LidarScan scan;
  for (int i = 0; i < count; ++i) {
    const Eigen::Vector3f direction(random.gaussian(), random.gaussian(), random.gaussian());
    const float range = reach_m * std::pow(random.uniform(0.05F, 1), 3.0F);  // many of them close
    const Eigen::Vector3f p = direction.normalized() * range;
    scan.points.push_back({p.x(), p.y(), p.z(), 0});
  }
  return scan;
}

DepthMap wall(const Camera& camera) {
  const auto pixels = static_cast<std::size_t>(camera.width()) * camera.height();
  return {camera.width(), camera.height(), std::vector<float>(pixels, 0.1F)};
}

/// A pair of which only the points matter.
FramePair only(const LidarScan& scan) { return {.image = {}, .right_image = {}, .scan = scan}; }

}  // namespace

TEST_CASE("ranks of depth do not change under any monotone distortion of the distance") {
  test::SimulatedDrive drive(31);
  const DepthMap metric = drive.depth(0);
  const LidarScan scan = drive.scan(0);
  const auto ranks = [&](const DepthMap& depth) {
    const FeatureSet features =
        test::require_ok(make_features(only(scan), depth, drive.camera(), drive.T_camera_lidar()));
    std::vector<int> found;
    for (const std::uint16_t pixel : features.planes->packed) found.push_back(FeaturePlanes::depth.rank(pixel));
    return found;
  };
  const auto original = ranks(metric);
  DepthMap scaled = metric, squared = metric;
  for (std::size_t i = 0; i < metric.inverse_depth.size(); ++i) {
    scaled.inverse_depth[i] *= 1.0F / 1024;
    const double length = ray_length(drive.camera(), i), inverse_distance = metric.inverse_depth[i] / length;
    squared.inverse_depth[i] = static_cast<float>(7 * inverse_distance * inverse_distance * length);
  }
  CHECK(ranks(scaled) == original);
  const auto of_squared = ranks(squared);
  int different = 0;
  for (std::size_t i = 0; i < original.size(); ++i) {
    REQUIRE(std::abs(original[i] - of_squared[i]) <= 4);  // four ranks make a class
    different += original[i] != of_squared[i];
  }
  CHECK(different < 0.001 * static_cast<double>(original.size()));  // rounding at the limits of classes
}

TEST_CASE("ranks grow with distance and every rank holds its share") {
  test::SimulatedDrive drive(32);
  const FeatureSet features = drive.features(0);
  const DepthMap depth = drive.depth(0);
  const Eigen::Vector3f p_lidar_camera = drive.T_camera_lidar().inverse().translation().cast<float>();
  std::vector<std::pair<float, int>> by_range;
  for (std::size_t i = 0; i < features.points(); ++i)
    by_range.emplace_back((features.point(i) - p_lidar_camera).norm(), features.range_rank[i]);
  std::ranges::sort(by_range);
  CHECK(std::ranges::is_sorted(by_range, {}, &std::pair<float, int>::second));

  std::vector<int> population(256);
  for (std::size_t i = 0; i < depth.inverse_depth.size(); ++i) {
    const int rank = FeaturePlanes::depth.rank(features.planes->packed[i]);
    ++population[rank];
    REQUIRE((rank == FeatureSet::none) == (depth.inverse_depth[i] == DepthMap::no_depth));
  }
  const double share = depth.valid_share() * static_cast<double>(depth.inverse_depth.size()) / FeatureSet::ranks;
  // Single ranks may be empty where many values are equal.
  for (int coarse = 0; coarse < FeatureSet::ranks; coarse += 12) {
    int sum = 0;
    for (int rank = coarse; rank < coarse + 12; ++rank) sum += population[rank];
    CHECK(sum == Approx(12 * share).epsilon(0.2));
  }
}

TEST_CASE("culling keeps every point that an extrinsic within the bounds brings into view") {
  vehicle::Random random(5);
  // A long lens, KITTI's, and a wide angle, of which the corners are the difficult part.
  // The last one's image is finer than the grid.
  const std::vector<std::vector<double>> lenses{
      {900, 900, 320, 96}, {372, 372, 318, 90}, {130, 130, 320, 96}, {720, 720, 636, 180}};
  for (const auto& intrinsics : lenses) {
    const bool fine = intrinsics[2] > 600;
    const Camera camera =
        test::require_ok(Camera::make(CameraModel::rectified, fine ? 1280 : 640, fine ? 384 : 192, intrinsics));
    for (int trial = 0; trial < 12; ++trial) {
      const SearchBounds bounds{random.uniform(0.01F, 0.2F), random.uniform(0, 0.6F)};
      RigidTransform T = RigidTransform::Identity();  // any mounting, up to two metres from the camera
      T.linear() =
          Eigen::Quaterniond(
              Eigen::Vector4d(random.gaussian(), random.gaussian(), random.gaussian(), random.gaussian()).normalized())
              .toRotationMatrix();
      T.translation() << random.uniform(-1.2F, 1.2F), random.uniform(-1.2F, 1.2F), random.uniform(-1.2F, 1.2F);
      const LidarScan scan = random_points(random, 4000, 40);
      const FeatureSet kept =
          test::require_ok(make_features(only(scan), wall(camera), camera, T, {.bounds = bounds, .min_points = 0}));
      std::set<std::tuple<float, float, float>> points;
      for (std::size_t i = 0; i < kept.points(); ++i) points.emplace(kept.x[i], kept.y[i], kept.z[i]);
      const auto rounded = [&](float value_m) { return std::round(value_m / kept.unit_m); };
      for (int corner = 0; corner < 64 + 20; ++corner) {
        Vector6 delta;
        for (int axis = 0; axis < 6; ++axis) {
          const double limit = axis < 3 ? bounds.rotation_rad : bounds.translation_m;
          delta[axis] = limit * (corner >= 64 ? random.uniform(-1, 1) : (corner >> axis & 1) != 0 ? 1 : -1);
        }
        const RigidTransform T_moved = T * perturbation(delta);
        int lost = 0;
        for (const LidarPoint& p : scan.points)
          if (camera.project(T_moved * Eigen::Vector3d(p.x_m, p.y_m, p.z_m)))
            lost += !points.contains({rounded(p.x_m), rounded(p.y_m), rounded(p.z_m)});
        REQUIRE(lost == 0);
      }
    }
  }
}

TEST_CASE("culling leaves out what no extrinsic within the bounds can bring into view") {
  test::SimulatedDrive drive(33, 640, 192, {.azimuth_step_deg = 0.5});
  const LidarScan around = drive.scan(0);
  const FeatureSet kept =
      test::require_ok(make_features(only(around), drive.depth(0), drive.camera(), drive.T_camera_lidar()));
  CHECK(static_cast<double>(kept.points()) < 0.45 * static_cast<double>(around.points.size()));
}

TEST_CASE("a frame of a 64-beam LiDAR and a 1242 x 375 camera is kept in less than 0.8 MB") {
  test::SimulatedDrive drive(34, 1242, 375, {.azimuth_step_deg = 0.17});
  const FeatureSet features = drive.features(0);
  CHECK(features.memory_bytes() < 800'000);
  CHECK(features.memory_bytes() > 2 * features.planes->packed.size() + 8 * features.points());
}

TEST_CASE("of a fine rectified image the grid holds every n-th pixel, as wide as a beam of a LiDAR") {
  const auto [width, height, focal, step] = GENERATE(
      std::make_tuple(1242, 375, 721.5, 2), std::make_tuple(1920, 1080, 1400.0, 4),
      std::make_tuple(1283, 721, 1100.0, 2),  // as coarse as leaves 480 columns
      std::make_tuple(1241, 40, 721.5, 2), std::make_tuple(9600, 16, 12000.0, 1), std::make_tuple(640, 192, 600.0, 1));
  const Camera camera = test::require_ok(
      Camera::make(CameraModel::rectified, width, height, {focal, focal, 0.49 * width, 0.46 * height}));
  DepthMap depth = wall(camera);
  for (std::size_t i = 0; i < depth.inverse_depth.size(); ++i)  // each pixel its own, the further the greater its index
    depth.inverse_depth[i] = static_cast<float>(ray_length(camera, i) / (1000 + static_cast<double>(i)));
  const FeatureSet features =
      test::require_ok(make_features(only({}), depth, camera, RigidTransform::Identity(), {.min_points = 0}));
  const BearingGrid& grid = features.planes->grid;
  CHECK(std::abs(grid.width * step - width) < step);
  CHECK(std::abs(grid.height * step - height) < step);
  REQUIRE(features.planes->packed.size() == grid.pixels());
  int last_rank = 0;
  for (int v = 0; v < grid.height; ++v)
    for (int u = 0; u < grid.width; ++u) {
      const auto uv = camera.project(grid.bearing(u, v));
      REQUIRE(uv);
      REQUIRE(uv->x() == Approx(u * step + step / 2).margin(0.01));
      REQUIRE(uv->y() == Approx(v * step + step / 2).margin(0.01));
      const int rank = FeaturePlanes::depth.rank(features.planes->packed[v * grid.width + u]);
      REQUIRE(rank >= last_rank);
      last_rank = rank;
    }
  CHECK(last_rank == FeaturePlanes::depth.rank(FeaturePlanes::depth.put(0, FeatureSet::ranks - 1)));
}

TEST_CASE("the grid of a lens of any model covers what the lens sees") {
  // A wall, n . p = 1, seen by lenses from long to more than half of all around; what is known is the distance along a
  // ray.
  const Eigen::Vector3d n(0.05, 0.08, 0.1);
  const auto lens = GENERATE(std::make_tuple(CameraModel::plumb_bob, 372.0, std::vector<double>{-0.2, 0.03, 0, 0}),
                             std::make_tuple(CameraModel::equidistant, 150.0, std::vector<double>{0, 0, 0, 0}),
                             std::make_tuple(CameraModel::double_sphere, 110.0, std::vector<double>{-0.2, 0.55}));
  const auto& [model, focal, distortion] = lens;
  const Camera camera = test::require_ok(Camera::make(model, 640, 480, {focal, focal, 318, 230}, distortion));
  const auto inverse_distance = [&](const Eigen::Vector3d& bearing) { return std::max(0.0, n.dot(bearing)); };
  DepthMap depth = wall(camera);
  depth.along_ray = true;
  for (int v = 0; v < camera.height(); ++v)
    for (int u = 0; u < camera.width(); ++u) {
      const auto bearing = camera.unproject(Eigen::Vector2d(u, v));
      depth.inverse_depth[v * camera.width() + u] = bearing ? static_cast<float>(inverse_distance(*bearing)) : 0;
    }
  vehicle::Random random(6);
  const FeatureSet features = test::require_ok(make_features(only(random_points(random, 4000, 40)), depth, camera,
                                                             RigidTransform::Identity(), {.min_points = 0}));
  const BearingGrid& grid = features.planes->grid;
  CHECK(static_cast<double>(grid.pixels()) == Approx(640 * 480).epsilon(0.02));
  std::vector<std::pair<double, int>> by_distance;
  int seen = 0, visible = 0;
  for (int v = 0; v < grid.height; v += 3)
    for (int u = 0; u < grid.width; u += 3) {
      const Eigen::Vector3d bearing = grid.bearing(u, v);
      const double x = grid.fx * bearing.x() / (bearing.z() + grid.xi) + grid.cx;
      REQUIRE(x == Approx(u).margin(1e-3));
      const int rank = FeaturePlanes::depth.rank(features.planes->packed[v * grid.width + u]);
      // Along its edge a wall that is seen from the side has no certain pixel.
      const bool expected = camera.project(bearing) && inverse_distance(bearing) > 0.005;
      visible += expected;
      seen += expected && rank != FeatureSet::none;
      REQUIRE((rank == FeatureSet::none || camera.project(bearing)));
      if (expected && rank != FeatureSet::none) by_distance.emplace_back(-inverse_distance(bearing), rank);
    }
  CHECK(visible > 0.1 * static_cast<double>(grid.pixels()) / 9);
  CHECK(seen > 0.995 * visible);
  std::ranges::sort(by_distance);
  int out_of_order = 0;  // ranks follow distance but for a pixel's rounding
  for (std::size_t i = 1; i < by_distance.size(); ++i)
    out_of_order += by_distance[i].second < by_distance[i - 1].second - 8;
  CHECK(out_of_order < 0.02 * static_cast<double>(by_distance.size()));
}

TEST_CASE("features about another extrinsic are those that would have been made there") {
  test::SimulatedDrive drive(37);
  const RigidTransform T = drive.T_camera_lidar() * test::knock(1, -2, 1.5, 0.1, -0.2, 0.1);
  const SearchBounds narrow{radians_per_degree, 0.1};
  const FeatureSet wide = drive.features(0);
  const FeatureSet moved = wide.about(T, narrow);
  const FeatureSet made = test::require_ok(
      make_features(drive.pair(0), drive.depth(0), drive.camera(), T, {.bounds = narrow, .min_points = 0}));
  CHECK(moved.planes == wide.planes);
  CHECK(moved.points() < wide.points());
  CHECK(moved.points() == made.points());
  // The order differs, and with it the sample that limits of ranks come from.
  std::map<std::tuple<float, float, float>, int> ranks;
  for (std::size_t i = 0; i < made.points(); ++i) ranks[{made.x[i], made.y[i], made.z[i]}] = made.range_rank[i];
  for (std::size_t i = 0; i < moved.points(); ++i) {
    const auto found = ranks.find({moved.x[i], moved.y[i], moved.z[i]});
    REQUIRE(found != ranks.end());
    REQUIRE(std::abs(found->second - moved.range_rank[i]) <= 6);
  }
}

TEST_CASE("limits of classes are those of the sorted values, whatever their sign and size") {
  vehicle::Random random(7);
  for (const float scale : {1e-30F, 1.F, 1e30F}) {
    std::vector<float> values;
    for (int i = 0; i < 5000; ++i) values.push_back(i % 7 == 0 ? 0 : i % 11 == 0 ? -0.F : scale * random.gaussian());
    std::vector<float> sorted = values;
    std::ranges::sort(sorted);
    const std::vector<float> limits = equal_population_limits(values);
    REQUIRE(limits.size() == FeatureSet::ranks - 1);
    for (std::size_t i = 0; i < limits.size(); ++i)
      CHECK(limits[i] == sorted[(i + 1) * sorted.size() / FeatureSet::ranks]);
    const RankClassifier rank_of(limits);
    for (const float value : values)
      REQUIRE(rank_of(value) == std::ranges::count_if(limits, [&](float limit) { return limit < value; }));
  }
}

TEST_CASE("points are kept to a few millimetres, also where one is far away") {
  for (const auto& [largest_m, unit_m] :
       {std::pair{80.F, 0.004F}, {127.9F, 0.004F}, {200.F, 0.008F}, {500.F, 0.016F}}) {
    FeatureSet features;
    const std::vector<Eigen::Vector3f> points{{largest_m, 1.234F, -0.001F}, {-largest_m, 0, 17.77F}};
    features.set_points(points, largest_m);
    CHECK(features.unit_m < unit_m);
    for (std::size_t i = 0; i < points.size(); ++i)
      CHECK((features.point(i) - points[i]).cwiseAbs().maxCoeff() <= features.unit_m / 2);
  }
}

TEST_CASE("the first of the points are an even sample of all") {
  test::SimulatedDrive drive(38);
  const FeatureSet features = drive.features(0);
  const auto mean = [&](std::size_t count) {
    Eigen::Vector3d sum(0, 0, 0);
    for (std::size_t i = 0; i < count; ++i) sum += features.point(i).cast<double>();
    return Eigen::Vector3d(sum / static_cast<double>(count));
  };
  for (const int part : {32, 8, 2}) CHECK((mean(features.points() / part) - mean(features.points())).norm() < 0.5);
}

TEST_CASE("too few points on depth are refused, as are a depth map of another size, no points and no depth") {
  test::SimulatedDrive drive(35);
  const DepthMap depth = drive.depth(0);
  const LidarScan scan = drive.scan(0);
  const auto refusal = [&](const DepthMap& from, const LidarScan& points, const RigidTransform& T) {
    const auto features = make_features(only(points), from, drive.camera(), T);
    return features ? "" : word(features.error().code);
  };
  CHECK(refusal(depth, scan, drive.T_camera_lidar()).empty());
  CHECK(refusal(depth, {}, drive.T_camera_lidar()) == "low_overlap");
  CHECK(refusal(depth, scan, drive.T_camera_lidar() * test::knock(0, 0, 170)) == "low_overlap");
  CHECK(refusal({}, scan, drive.T_camera_lidar()) == "depth_failed");
  DepthMap nothing = depth;
  std::ranges::fill(nothing.inverse_depth, std::numeric_limits<float>::quiet_NaN());
  CHECK(refusal(nothing, scan, drive.T_camera_lidar()) == "low_overlap");
}

TEST_CASE("a point that is not a number or too far away, or such an extrinsic, never gets into a feature set") {
  test::SimulatedDrive drive(36);
  constexpr float nan = std::numeric_limits<float>::quiet_NaN();
  LidarScan scan = drive.scan(0);
  scan.points.insert(scan.points.begin() + 7, {{nan, 1, 1, 0}, {10, nan, 0, 0}, {10, 0, nan, 0}, {1e6F, 0, 0, 0}});
  const FeatureSet features =
      test::require_ok(make_features(only(scan), drive.depth(0), drive.camera(), drive.T_camera_lidar()));
  CHECK(features.x == drive.features(0).x);
  CHECK(features.range_rank == drive.features(0).range_rank);
  RigidTransform T = drive.T_camera_lidar();
  T.translation().x() = nan;
  CHECK(make_features(only(scan), drive.depth(0), drive.camera(), T).error().code == "low_overlap");
}
