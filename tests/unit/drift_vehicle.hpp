#pragma once

#include <cmath>

#include "calib/drift.hpp"
#include "vehicle/random.hpp"

namespace calib::test {

/// A vehicle whose objective has, for each axis, a maximum that is off the extrinsic by `offset` stencil steps,
/// measured with normal noise of `noise` steps.
class Vehicle {
 public:
  static constexpr double noise = 0.1;
  Vector6 offset = Vector6::Zero();

  explicit Vehicle(std::uint64_t seed) : random_(seed) {}

  AxisEvidence see() {
    AxisEvidence evidence{.stamp = now += std::chrono::seconds(10), .score = 1.2, .sensitivity = Matrix6::Zero()};
    evidence.prominence = prominence + prominence_noise * random_.gaussian();
    for (int axis = 0; axis < 6; ++axis) {
      const double h = StencilStep{}.of_axis(axis);
      error_[axis] = correlation * error_[axis] + std::sqrt(1 - correlation * correlation) * random_.gaussian();
      evidence.slope[axis] = hill / h * (offset[axis] + noise * error_[axis]);
      (*evidence.sensitivity)(axis, axis) = hill / (h * h) * (1 + 0.3 * random_.gaussian());
    }
    return evidence;
  }
  DriftVerdict drive(DriftMonitor& monitor, int pairs) {
    for (int i = 0; i < pairs; ++i) monitor.observe(see());
    return monitor.verdict();
  }

  static constexpr double prominence_noise = 0.005;
  double prominence = 0.02;  // by which the extrinsic stands above its neighbours
  Timestamp now{};
  double correlation = 0;  // of the noise of consecutive pairs

 private:
  static constexpr double hill = 0.02;
  Vector6 error_ = Vector6::Zero();
  vehicle::Random random_;
};

/// Looks for shifts however small.
inline const DriftSettings keen{.negligible_rotation_rad = 0, .negligible_translation_m = 0};

/// Pairs until the verdict is drifted, at most `most`.
inline int pairs_until_drifted(Vehicle& vehicle, DriftMonitor& monitor, int most) {
  int pairs = 0;
  while (pairs < most && monitor.verdict() != DriftVerdict::drifted) pairs += (vehicle.drive(monitor, 1), 1);
  return pairs;
}

}  // namespace calib::test
