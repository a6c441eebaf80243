#include "calib/mutual_information.hpp"

#include <hwy/targets.h>
#include <cmath>
#include <functional>
#include <limits>
#include <memory>
#include <set>
#include <string_view>

#include "calib/search.hpp"
#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
#include "vehicle/random.hpp"

using namespace calib;

namespace {

constexpr int side = FeatureSet::ranks;

using RankAt = std::function<int(int, int)>;

/// One point on each pixel of a square image, ten metres in front of it at the identity extrinsic. `first` is a feature
/// of the points, `second` of the pixels: of depth, of depth by tiles, and of intensity alike.
FeatureSet board(const RankAt& first, const RankAt& second) {
  FeaturePlanes planes;
  planes.grid = {side, side, 300, 300, side / 2, side / 2, 0};
  planes.max_angle_rad = 0.6;
  std::vector<std::uint8_t> of_pixels(planes.grid.pixels(), FeatureSet::none);
  FeatureSet features;
  std::vector<Eigen::Vector3f> points;
  for (int v = 0; v < side; ++v)
    for (int u = 0; u < side; ++u) {
      points.emplace_back(10 * (static_cast<float>(u) - planes.grid.cx) / planes.grid.fx,
                          10 * (static_cast<float>(v) - planes.grid.cy) / planes.grid.fy, 10);
      features.range_rank.push_back(static_cast<std::uint8_t>(first(u, v)));
      of_pixels[v * side + u] = static_cast<std::uint8_t>(second(u, v));
    }
  features.set_points(points, 10);
  for (const std::uint8_t rank : of_pixels) {
    std::uint16_t& pixel = planes.packed.emplace_back();
    for (const auto& where : {FeaturePlanes::depth, FeaturePlanes::tile_depth, FeaturePlanes::grey})
      pixel = where.put(pixel, rank);
  }
  planes.grey_rank = planes.depth_linear = planes.grey_linear = of_pixels;
  features.reflectance_rank = features.range_linear = features.reflectance_linear = features.range_rank;
  features.planes = std::make_shared<const FeaturePlanes>(std::move(planes));
  return features;
}

Objective of_classes(int ranks_per_class, FeaturePair features = FeaturePair::depth, bool normalised = true) {
  Objective objective;
  objective.terms[0] = {features, 1, ranks_per_class, normalised};
  return objective;
}

int along(int u, int) { return u; }
int across(int, int v) { return v; }
int chance(int u, int v) { return static_cast<int>(vehicle::mix(u, v) % FeatureSet::ranks); }

double at_identity(const FeatureSet& features, const Objective& objective = depth_objective) {
  return score(features, RigidTransform::Identity(), objective).value;
}

}  // namespace

TEST_CASE("independent features score one, and identical ones more than any that are disturbed") {
  for (const int ranks_per_class : {4, 8, 16}) {
    const Objective options = of_classes(ranks_per_class);
    CHECK(at_identity(board(along, across), options) == Approx(1).margin(1e-9));
    double last = at_identity(board(along, along), options);
    CHECK(last <= 2);
    CHECK(last > 1.3);  // smoothing keeps it from 2, most so where classes are few
    for (const int disturbed_in_16 : {1, 4, 8, 12, 16}) {
      const auto disturbed = [&](int u, int v) {
        return static_cast<int>(vehicle::mix(9, u, v) % 16) < disturbed_in_16 ? chance(u, v) : u;
      };
      const double value = at_identity(board(along, disturbed), options);
      CHECK(value < last);
      CHECK(value >= 1);
      last = value;
    }
    CHECK(last < 1.02);  // what chance alone makes
  }
}

TEST_CASE("the score does not change when the two features change places or are turned round") {
  const auto some = [](int u, int v) { return (u + chance(u, v) / 8) % FeatureSet::ranks; };
  const auto turned = [&](int u, int v) { return FeatureSet::ranks - 1 - some(u, v); };
  const double value = at_identity(board(along, some));
  CHECK(at_identity(board(some, along)) == Approx(value).epsilon(1e-12));
  CHECK(at_identity(board(along, turned)) == Approx(value).epsilon(1e-9));
}

TEST_CASE("what is out of view, behind the camera, without depth or too little is no information") {
  const FeatureSet features = board(along, along);
  const RigidTransform identity = RigidTransform::Identity();
  CHECK(score(features, identity).points == side * side);
  CHECK(score(features, identity, {.terms = {}, .stride = 4}).points == side * side / 4);
  const auto nothing = [](const FeatureSet& frame, const RigidTransform& T) {
    const Score seen = score(frame, T);
    return seen.value == 1 && seen.points < min_scored_points;
  };
  CHECK(nothing(features, RigidTransform(Eigen::AngleAxisd(3, Eigen::Vector3d::UnitY()))));
  CHECK(nothing(features, RigidTransform(Eigen::Translation3d(500, 0, 0))));
  CHECK(nothing(features, RigidTransform(Eigen::Translation3d(0, 0, -10))));  // on the camera itself
  RigidTransform not_a_number = identity;
  not_a_number.matrix().topRows<3>().setConstant(std::numeric_limits<double>::quiet_NaN());
  CHECK(nothing(features, not_a_number));
  CHECK(nothing(board(along, [](int, int) { return int{FeatureSet::none}; }), identity));
  const auto never = [](int, int) { return 0; };
  FeatureSet no_points = board(never, never);
  no_points.set_points({}, 1);
  no_points.range_rank.clear();
  CHECK(nothing(no_points, identity));
  FeatureSet without = board(along, along);  // the features that only the published methods need
  FeaturePlanes planes = *without.planes;
  planes.grey_rank.clear();
  without.planes = std::make_shared<const FeaturePlanes>(std::move(planes));
  CHECK(at_identity(without, of_classes(4, FeaturePair::fine_intensity)) == 1);
  CHECK(mean_score({}, identity).value == 0);
  // All points in one class: nothing to be told apart.
  CHECK(at_identity(board([](int, int) { return 100; }, [](int, int) { return 100; })) <= 1.01);
}

TEST_CASE("the paper's mutual information is that of the counts, in nats") {
  // Of two equal uniform features with c classes it is log c; of independent ones, nearly nothing.
  using enum FeaturePair;
  for (const auto features : {linear_depth, linear_intensity, fine_intensity, depth, intensity})
    for (const int ranks_per_class : {1, 4, 8, 16}) {
      if (ranks_per_class < (features == depth ? 4 : features == intensity ? 8 : 1)) continue;
      const Objective plain = of_classes(ranks_per_class, features, false);
      CHECK(at_identity(board(along, along), plain) ==
            Approx(std::log(FeatureSet::ranks / ranks_per_class)).epsilon(1e-9));
      CHECK(at_identity(board(along, across), plain) == Approx(0).margin(1e-9));
    }
}

TEST_CASE("by tiles a monotone change of the depth that differs from tile to tile changes nothing") {
  test::SimulatedDrive drive(43);
  DepthMap biased = drive.depth(0);
  for (int v = 0; v < biased.height; ++v)
    for (int u = 0; u < biased.width; ++u) {
      const int tile = u * FeatureSet::tile_columns / biased.width + 10 * (v * FeatureSet::tile_rows / biased.height);
      biased.inverse_depth[v * biased.width + u] *= static_cast<float>(1 << (tile % 3));
    }
  const auto features = [&](const DepthMap& depth) {
    return test::require_ok(make_features(drive.pair(0), depth, drive.camera(), drive.T_camera_lidar()));
  };
  const FeatureSet good = features(drive.depth(0)), bad = features(biased);
  const auto at_truth = [&](const FeatureSet& frame, FeaturePair pair) {
    return score(frame, drive.T_camera_lidar(), of_classes(8, pair)).value;
  };
  CHECK(at_truth(bad, FeaturePair::tiled_depth) == Approx(at_truth(good, FeaturePair::tiled_depth)).epsilon(1e-9));
  CHECK(at_truth(bad, FeaturePair::depth) < at_truth(good, FeaturePair::depth) - 0.01);
}

TEST_CASE("an objective is the weighted mean of its terms, and a term without features carries no information") {
  test::SimulatedDrive drive(44);
  FeatureSet frame = drive.features(0);
  const RigidTransform& T = drive.T_camera_lidar();
  Objective both = of_classes(4);
  both.terms[1] = {FeaturePair::intensity, 3, 8, true};
  both.count = 2;
  const double depth = score(frame, T).value, intensity = score(frame, T, of_classes(8, FeaturePair::intensity)).value;
  CHECK(score(frame, T, both).value == Approx((depth + 3 * intensity) / 4).epsilon(1e-12));
  CHECK(intensity > 1.001);
  frame.reflectance_rank.clear();  // a LiDAR that gives none
  CHECK(score(frame, T, both).value == Approx((depth + 3) / 4).epsilon(1e-12));
}

TEST_CASE("the vector code counts what plain arithmetic counts, whatever the lens") {
  const auto model = GENERATE(CameraModel::rectified, CameraModel::equidistant);
  const std::vector<double> distortion(model == CameraModel::rectified ? 0 : 4, 0.0);
  const Camera camera = test::require_ok(Camera::make(model, 320, 240, {110, 110, 158, 122}, distortion));
  vehicle::Random random(8);
  FramePair pair;
  for (int i = 0; i < 3001; ++i)  // no multiple of any vector's length
    pair.scan.points.push_back({random.uniform(-20, 20), random.uniform(-20, 20), random.uniform(-20, 20), 0});
  DepthMap depth{320, 240, std::vector<float>(320 * 240), true};
  for (float& inverse : depth.inverse_depth) inverse = random.uniform(-0.2F, 1);  // some have none
  const RigidTransform T = test::knock(20, -30, 40, 0.1, 0.2, 0.3);
  const FeatureSet features = test::require_ok(
      make_features(pair, depth, camera, T, {.bounds = {.rotation_rad = 2, .translation_m = 1}, .min_points = 0}));
  const FeaturePlanes& planes = *features.planes;
  std::size_t expected = 0;
  for (std::size_t i = 0; i < features.points(); ++i) {
    const Eigen::Vector3d p = T * features.point(i).cast<double>();
    const double denominator = p.z() + planes.grid.xi * p.norm();
    const double u = std::floor(planes.grid.fx * p.x() / denominator + planes.grid.cx + 0.5);
    const double v = std::floor(planes.grid.fy * p.y() / denominator + planes.grid.cy + 0.5);
    if (denominator > 0 && u >= 0 && v >= 0 && u < planes.grid.width && v < planes.grid.height)
      expected += FeaturePlanes::depth.rank(
                      planes.packed[static_cast<std::size_t>(v) * planes.grid.width + static_cast<std::size_t>(u)]) !=
                  FeatureSet::none;
  }
  CHECK(expected > 200);
  // A point on a pixel's border may fall to either side in single precision.
  CHECK(std::abs(static_cast<double>(score(features, T).points) - static_cast<double>(expected)) <= 2);
}

TEST_CASE("every vector path that this processor has scores alike, and each always the same") {
  test::SimulatedDrive drive(45);
  const FeatureSet frame = drive.features(0);
  const RigidTransform T = drive.T_camera_lidar() * test::knock(0.3, -0.2, 0.4);
  const Objective objective = final_objective(Method::standard, {true, true, true, true, true, true});
  const Score usual = score(frame, T, objective);
  std::set<std::string_view> names;
  for (const std::int64_t target : hwy::SupportedAndGeneratedTargets()) {
    hwy::SetSupportedTargetsForTest(target);
    names.insert(vector_instructions());
    const Score here = score(frame, T, objective);
    CHECK(here.value == Approx(usual.value).margin(1e-3));
    CHECK(std::abs(static_cast<double>(here.points) - static_cast<double>(usual.points)) < 10);
    CHECK(score(frame, T, objective).value == here.value);
  }
  hwy::SetSupportedTargetsForTest(0);
  CHECK(names.size() == hwy::SupportedAndGeneratedTargets().size());
  CHECK(score(frame, T, objective).value == usual.value);
}

TEST_CASE("on frames of a street the truth scores best") {
  test::SimulatedDrive drive(41);
  const auto frames = drive.features_of(4, RigidTransform::Identity());
  const auto all = test::pointers(frames);
  const RigidTransform& T = drive.T_camera_lidar();
  const double best = mean_score(all, T).value;
  vehicle::Random random(3);
  for (int trial = 0; trial < 60; ++trial) {
    const Eigen::Vector3d direction(random.gaussian(), random.gaussian(), random.gaussian());
    const Eigen::Vector3d rotation = direction.normalized() * random.uniform(0.5F, 4);
    CHECK(mean_score(all, T * test::knock(rotation.x(), rotation.y(), rotation.z())).value < best);
  }
  for (int axis = 3; axis < 6; ++axis)
    for (const double shift_m : {-0.4, 0.4})
      CHECK(mean_score(all, T * perturbation(Vector6::Unit(axis) * shift_m)).value < best);

  double sum = 0;
  std::size_t points = 0;
  for (const FeatureSet& frame : frames) {
    const Score one = score(frame, T);
    CHECK(one.value > 1.05);
    CHECK(one.value < 2);
    sum += one.value;
    points += one.points;
    CHECK(score(frame, T).value == one.value);  // bit for bit
  }
  CHECK(best == sum / 4);
  CHECK(mean_score(all, T).points == points);

  const std::vector<RigidTransform> several{T, T * test::knock(0, 0, 1), T};
  const std::vector<Score> scores = mean_scores(all, several);
  REQUIRE(scores.size() == several.size());
  for (std::size_t i = 0; i < several.size(); ++i) {
    CHECK(scores[i].value == mean_score(all, several[i]).value);
    CHECK(scores[i].points == mean_score(all, several[i]).points);
  }
}

TEST_CASE("the score depends on where things are, not on where the LiDAR's frame is put") {
  test::SimulatedDrive drive(42);
  const FeatureSet frame = drive.features(0);
  const RigidTransform turn = test::knock(10, -20, 130, 1, 2, -3);
  FeatureSet moved = frame;
  std::vector<Eigen::Vector3f> points;
  for (std::size_t i = 0; i < frame.points(); ++i)
    points.emplace_back((turn.inverse() * frame.point(i).cast<double>()).cast<float>());
  moved.set_points(points, 120);
  CHECK(score(moved, drive.T_camera_lidar() * turn).value ==
        Approx(score(frame, drive.T_camera_lidar()).value).margin(1e-3));
}
