#pragma once

#include <cmath>
#include <random>
#include <string>
#include <vector>

#include "calib/store.hpp"
#include "support/support.hpp"

namespace calib::test {

/// Text with everything in it that JSON, minisign or a terminal could stumble over; always UTF-8.
inline std::string random_text(std::mt19937& random) {
  static const std::vector<std::string> pieces{"front", " ",  "\"", "\\", "\n", "\t", "\x01", "\x1b[31m", "\x7f",
                                               "/",     "\r", "ä",  "路", "🚗", "0",  ",",    "}",        ""};
  std::string text;
  for (int i = static_cast<int>(random() % 6); i > 0; --i) text += pieces[random() % pieces.size()];
  return text;
}

/// Any magnitude that a double has, or a number as people write them.
inline double random_number(std::mt19937& random) {
  std::uniform_real_distribution<double> unit(-1, 1);
  switch (random() % 4) {
    case 0:
      return std::ldexp(unit(random), static_cast<int>(random() % 2000) - 1000);
    case 1:
      return static_cast<double>(random() % 100) / 100;
    case 2:
      return random() % 2 == 0 ? 0.0 : -0.0;
    default:
      return unit(random);
  }
}

inline RigidTransform random_transform(std::mt19937& random) {
  Vector6 delta;
  std::uniform_real_distribution<double> unit(-1, 1);
  for (double& value : delta) value = unit(random);
  return perturbation(delta);
}

inline CalibrationRecord::Baseline random_baseline(std::mt19937& random) {
  CalibrationRecord::Baseline baseline;
  baseline.pairs = 2 + random() % 1000;
  for (double& value : baseline.slope) value = random_number(random);
  for (double& value : baseline.slope_correlation) value = random_number(random);
  for (double& value : baseline.sensitivity.reshaped()) value = random_number(random);
  for (double& value : baseline.sensitivity_deviation) value = std::abs(random_number(random));
  for (int row = 0; row < 6; ++row)
    for (int column = 0; column <= row; ++column)
      baseline.slope_covariance(row, column) = baseline.slope_covariance(column, row) =
          row == column ? std::abs(random_number(random)) : random_number(random);
  baseline.prominence = random_number(random);
  baseline.prominence_deviation = std::abs(random_number(random));
  baseline.prominence_correlation = random_number(random);
  baseline.score = random_number(random);
  baseline.score_deviation = std::abs(random_number(random));
  return baseline;
}

inline CalibrationRecord random_record(std::mt19937& random) {
  const auto vector6 = [&] {
    Vector6 values;
    for (double& value : values) value = random_number(random);
    return values;
  };
  CalibrationRecord record;
  record.vehicle = random_text(random);
  record.pair = random_text(random);
  record.sequence = 1 + random() % 1'000'000;
  record.previous_sha256 = sha256_hex(std::to_string(random()));
  record.decision = static_cast<Decision>(random() % 6);
  if (record.decision == Decision::baseline) record.baseline = random_baseline(random);
  record.reason = random_text(random);
  record.asked_by = random_text(random);
  record.T_camera_lidar = random_transform(random);
  record.T_camera_lidar_before = random_transform(random);
  if (random() % 2 == 0) record.sigma = vector6();
  if (random() % 2 == 0)
    record.score = CalibrationRecord::Score{random_number(random), random_number(random), random_number(random),
                                            random_number(random)};
  for (int i = static_cast<int>(random() % 30); i > 0; --i)
    record.frame_stamps_ns.push_back(static_cast<std::int64_t>(random()) << 31);
  record.configuration_sha256 = sha256_hex("configuration");
  record.software_version = "1.2.3";
  record.software_sha256 = sha256_hex("software");
  if (random() % 2 == 0) record.evidence_sha256 = sha256_hex("evidence");
  record.wall_time = std::chrono::nanoseconds(static_cast<std::int64_t>(random()) * 429'496'729);
  record.boot_id = "0c9e7a54-6f5e-4a52-9f0a-7c57a6f0f9ab";
  record.boot_time = std::chrono::nanoseconds(static_cast<std::int64_t>(random()) << 20);
  return record;
}

/// Signs `record` as the next one of a chain that ends with `chain.back()`.
inline SignedRecord sign_next(CalibrationRecord record, const std::vector<SignedRecord>& chain, const SigningKey& key) {
  record.sequence = chain.size() + 1;
  record.previous_sha256 = chain.empty() ? std::string(no_previous_sha256) : sha256_hex(chain.back().canonical);
  return require_ok(sign_record(record, key));
}

/// `count` random records, each following the one before it.
inline std::vector<SignedRecord> random_chain(std::mt19937& random, std::size_t count, const SigningKey& key) {
  std::vector<SignedRecord> chain;
  while (chain.size() < count) chain.push_back(sign_next(random_record(random), chain, key));
  return chain;
}

}  // namespace calib::test
