#include "calib/mutual_information.hpp"

#include <functional>
#include <limits>

#include "support/catch.hpp"
#include "support/simulated_drive.hpp"
#include "vehicle/random.hpp"

using namespace calib;

namespace {

constexpr int side = 252;

/// One point on each pixel of a square image, ten metres in front of it at the identity extrinsic.
FeatureSet board(const std::function<int(int, int)>& range_rank, const std::function<int(int, int)>& depth_rank) {
  FeatureSet features;
  features.width = features.height = side;
  features.fx = features.fy = 300;
  features.cx = features.cy = side / 2;
  for (int v = 0; v < side; ++v)
    for (int u = 0; u < side; ++u) {
      features.x_m.push_back(10 * (static_cast<float>(u) - features.cx) / features.fx);
      features.y_m.push_back(10 * (static_cast<float>(v) - features.cy) / features.fy);
      features.z_m.push_back(10);
      features.range_rank.push_back(static_cast<std::uint8_t>(range_rank(u, v)));
      features.depth_rank.push_back(static_cast<std::uint8_t>(depth_rank(u, v)));
    }
  return features;
}

int along(int u, int) { return u; }
int across(int, int v) { return v; }
int chance(int u, int v) { return static_cast<int>(vehicle::mix(u, v) % FeatureSet::ranks); }

double at_identity(const FeatureSet& features, const ObjectiveOptions& options = {}) {
  return score(features, RigidTransform::Identity(), options).value;
}

}  // namespace

TEST_CASE("independent features score one, and identical ones more than any that are disturbed") {
  for (const int bins : {2, 7, 16, 32, 64}) {
    const ObjectiveOptions options{.bins = bins};
    CHECK(at_identity(board(along, across), options) == Approx(1).margin(1e-9));
    double last = at_identity(board(along, along), options);
    CHECK(last <= 2);
    CHECK(last > (bins >= 16 ? 1.3 : 1.02));  // smoothing keeps it from 2, most so where bins are few
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
  CHECK(at_identity(board(along, turned), {.bins = 63}) ==
        Approx(at_identity(board(along, some), {.bins = 63})).epsilon(1e-9));
}

TEST_CASE("what is out of view, behind the camera, without depth or too little is no information") {
  const FeatureSet features = board(along, along);
  const RigidTransform identity = RigidTransform::Identity();
  CHECK(score(features, identity).points == side * side);
  CHECK(score(features, identity, {.stride = 4}).points == side * side / 4);
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
  CHECK(nothing(board(along, [](int, int) { return int{FeatureSet::no_depth}; }), identity));
  CHECK(nothing(FeatureSet{}, identity));
  CHECK(mean_score({}, identity).value == 0);
  // All points in one class: nothing to be told apart.
  CHECK(at_identity(board([](int, int) { return 100; }, [](int, int) { return 100; })) <= 1.01);
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
}

TEST_CASE("the score depends on where things are, not on where the LiDAR's frame is put") {
  test::SimulatedDrive drive(42);
  const FeatureSet frame = drive.features(0);
  const RigidTransform turn = test::knock(10, -20, 130, 1, 2, -3);
  FeatureSet moved = frame;
  for (std::size_t i = 0; i < frame.x_m.size(); ++i) {
    const Eigen::Vector3d p = turn.inverse() * Eigen::Vector3d(frame.x_m[i], frame.y_m[i], frame.z_m[i]);
    moved.x_m[i] = static_cast<float>(p.x());
    moved.y_m[i] = static_cast<float>(p.y());
    moved.z_m[i] = static_cast<float>(p.z());
  }
  CHECK(score(moved, drive.T_camera_lidar() * turn).value ==
        Approx(score(frame, drive.T_camera_lidar()).value).margin(1e-3));
}
