#pragma once

#include <Eigen/Core>
#include <nlohmann/json.hpp>
#include <stdexcept>
#include <string>

#include "calib/geometry.hpp"

// What the JSON forms of records and status share. Private to libcalib: the readers throw what nlohmann
// throws (or std::invalid_argument), and whoever calls them turns that into a Result before it leaves the
// library.
namespace calib::json_fields {

/// `json` as text: keys sorted by their bytes, no white space, numbers as the shortest text that reads back
/// as the same value, written as Python writes them (`1.0`, `1e-05`), so that `json.dumps(x, sort_keys=True,
/// separators=(",", ":"), ensure_ascii=False)` gives the same bytes. Numbers that are not finite become null.
[[nodiscard]] std::string canonical_text(const nlohmann::json& json);

template <int N>
[[nodiscard]] nlohmann::json array_of(const Eigen::Matrix<double, N, 1>& vector) {
  nlohmann::json array = nlohmann::json::array();
  for (const double value : vector) array.push_back(value);
  return array;
}

/// N numbers; fails on any other count.
template <int N>
[[nodiscard]] Eigen::Matrix<double, N, 1> vector_from(const nlohmann::json& array) {
  if (!array.is_array() || array.size() != N)
    throw std::invalid_argument("a list of " + std::to_string(N) + " numbers is needed");
  Eigen::Matrix<double, N, 1> vector;
  for (int i = 0; i < N; ++i) {
    if (!array[i].is_number()) throw std::invalid_argument("a list holds what is not a number");
    vector[i] = array[i].get<double>();
  }
  return vector;
}

[[nodiscard]] RigidTransform transform_from(const nlohmann::json& json);

}  // namespace calib::json_fields
