#pragma once

namespace calib {

/// Where `positive` stops to hold between `inside`, where it does, and `outside`, where it does not.
template <typename Predicate>
double boundary(double inside, double outside, const Predicate& positive) {
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (inside + outside);
    (positive(middle) ? inside : outside) = middle;
  }
  return inside;
}

}  // namespace calib
