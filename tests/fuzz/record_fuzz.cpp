#include "calib/record.hpp"

#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  CalibrationRecord record;
  record.vehicle = "demo-car";
  record.pair = "front";
  record.sequence = 2;
  record.previous_sha256 = sha256_hex("");
  record.decision = Decision::baseline;
  record.reason = "learned from 20 pairs";
  record.asked_by = "calibd";
  record.sigma = Vector6::Constant(0.001);
  record.score = CalibrationRecord::Score{0.1, 0.2, 0.1, 0.2};
  CalibrationRecord::Baseline baseline;
  baseline.pairs = 20;
  baseline.slope_covariance.setIdentity();
  record.baseline = baseline;
  record.frame_stamps_ns = {1, 2, 3};
  record.configuration_sha256 = record.software_sha256 = sha256_hex("a");
  record.software_version = "0.1.0";
  record.wall_time = std::chrono::seconds(1'700'000'000);
  record.boot_id = "0c4c2d5e-6a39-4d0c-9d8e-1b7f6f9e2a11";
  record.boot_time = std::chrono::seconds(100);
  return {octets(canonical_bytes(record))};
}

}  // namespace calib::fuzz

/// What is taken is in canonical form: a record has one spelling, or its signature would not mean one thing.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const std::string_view canonical = calib::fuzz::text(bytes, size);
  const auto record = calib::parse_record(canonical);
  if (record)
    calib::fuzz::require(calib::canonical_bytes(*record) == canonical);
  else
    calib::fuzz::require(record.error().code == calib::ErrorCode::malformed_record);
  return 0;
}
