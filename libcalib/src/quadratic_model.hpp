#pragma once

#include <Eigen/Core>
#include <vector>

namespace calib {

/// Orthogonal axes (columns), different ones for each `turn`, so that a few turns move all parameters together.
[[nodiscard]] Eigen::MatrixXd turned_axes(int parameters, int turn);

/// A quadratic fitted to samples of the objective by least squares, which averages out the local maxima that noise
/// makes.
class QuadraticModel {
 public:
  struct Sample {
    Eigen::VectorXd at;
    double value;
  };
  explicit QuadraticModel(int parameters) : parameters_(parameters), best_{Eigen::VectorXd::Zero(parameters), -1e300} {}

  void add(Sample sample);
  [[nodiscard]] const Sample& best() const { return best_; }

  /// From the best sample to the maximum of the quadratic, at most `longest` radii. Nearer samples have more weight.
  /// The prior of the curvature, for directions that the samples do not determine, loses `loss` within a radius to both
  /// sides together.
  [[nodiscard]] Eigen::VectorXd step_to_maximum(double radius, double loss, double longest) const;

 private:
  int parameters_;
  Sample best_;
  std::vector<Sample> samples_;
};

}  // namespace calib
