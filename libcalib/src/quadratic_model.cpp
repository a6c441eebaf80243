#include "quadratic_model.hpp"

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <algorithm>
#include <bit>
#include <cmath>

namespace calib {

Eigen::MatrixXd turned_axes(int parameters, int turn) {
  const Eigen::MatrixXd axes = Eigen::MatrixXd::Identity(parameters, parameters);
  if (turn == 0) return axes;
  Eigen::VectorXd signs(parameters);
  for (int i = 0; i < parameters; ++i) signs[i] = std::popcount(static_cast<unsigned>(i & turn)) % 2 == 0 ? 1 : -1;
  return axes - 2.0 / parameters * signs * signs.transpose();  // a reflection
}

void QuadraticModel::add(Sample sample) {
  if (sample.value > best_.value) best_ = sample;
  samples_.push_back(std::move(sample));
}

Eigen::VectorXd QuadraticModel::step_to_maximum(double radius, double loss, double longest) const {
  constexpr double prior = 0.1;  // weight of the curvature's prior, in samples
  const int unknowns = 1 + parameters_ + parameters_ * (parameters_ + 1) / 2;
  const auto each_pair = [&](const auto& visit) {
    for (int i = 0, k = 1 + parameters_; i < parameters_; ++i)
      for (int j = 0; j <= i; ++j, ++k) visit(i, j, k);
  };
  Eigen::MatrixXd normal = Eigen::MatrixXd::Zero(unknowns, unknowns);
  Eigen::VectorXd right = Eigen::VectorXd::Zero(unknowns), row(unknowns);
  for (const Sample& sample : samples_) {
    const Eigen::VectorXd d = (sample.at - best_.at) / radius;
    row[0] = 1;
    row.segment(1, parameters_) = d;
    each_pair([&](int i, int j, int k) { row[k] = (i == j ? -0.5 : -1) * d[i] * d[j]; });
    const double weight = 1 / (1 + std::pow(d.squaredNorm() / 4, 2));
    normal += weight * row * row.transpose();
    right += weight * sample.value * row;
  }
  each_pair([&](int i, int j, int k) {
    normal(k, k) += prior;
    if (i == j) right[k] += prior * loss;
  });
  const Eigen::VectorXd solved = normal.ldlt().solve(right);
  Eigen::MatrixXd curvature(parameters_, parameters_);
  each_pair([&](int i, int j, int k) { curvature(i, j) = curvature(j, i) = solved[k]; });
  const Eigen::SelfAdjointEigenSolver<Eigen::MatrixXd> axes(curvature);
  const Eigen::VectorXd slope = axes.eigenvectors().transpose() * solved.segment(1, parameters_);
  // Directions with less curvature, or with that of a minimum, get this much.
  const double flattest = std::max(0.1 * loss, 1e-12);
  Eigen::VectorXd step = slope.cwiseQuotient(axes.eigenvalues().cwiseMax(flattest));
  step *= std::min(1.0, longest / std::max(step.norm(), 1e-12));
  return radius * (axes.eigenvectors() * step);
}

}  // namespace calib
