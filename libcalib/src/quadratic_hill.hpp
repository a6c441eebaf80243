#pragma once

#include <Eigen/Core>
#include <vector>

namespace calib {

/// Orthogonal axes (columns), others for each `turn`, so that after a few turns all parameters were moved together.
[[nodiscard]] Eigen::MatrixXd turned_axes(int parameters, int turn);

/// A quadratic through samples of a hill, by least squares: it looks through the small hills that noise makes on it.
class QuadraticHill {
 public:
  struct Sample {
    Eigen::VectorXd at;
    double value;
  };
  explicit QuadraticHill(int parameters) : parameters_(parameters), best_{Eigen::VectorXd::Zero(parameters), -1e300} {}

  void add(Sample sample);
  [[nodiscard]] const Sample& best() const { return best_; }

  /// From the best sample to the top, `longest` radii at most. Samples count by how near they are to the best. Where
  /// they do not tell the curvature, it is such that to both sides together `loss` is lost within a radius.
  [[nodiscard]] Eigen::VectorXd step_to_top(double radius, double loss, double longest) const;

 private:
  int parameters_;
  Sample best_;
  std::vector<Sample> samples_;
};

}  // namespace calib
