#include "calib/cusum.hpp"

#include <algorithm>
#include <cmath>

namespace calib {

void Cusum::update(double value, Timestamp stamp, double limit) {
  if (sum <= 0) onset = stamp;
  sum = std::clamp(sum + std::min(value, max_update_share * limit), 0.0, cap_share * limit);
}

double cusum_limit(double k, double average_run_length) {
  // The run length is about exp(2 k (limit + 1.166)) / (2 k^2).
  return std::log(2 * k * k * average_run_length) / (2 * k) - 1.166;
}

}  // namespace calib
