// write_store KEY FOLDER VERDICT [baseline]: a store of three records (initial, rejected, accepted), and a fourth if
// asked for, signed with KEY, and the snapshot that a daemon with that store would leave. For tests of programs that
// read; they are written by the real library.
#include <time.h>

#include <fstream>
#include <iostream>
#include <limits>
#include <nlohmann/json.hpp>

#include "calib/status.hpp"
#include "calib/store.hpp"
#include "support/support.hpp"

using namespace calib;
using calib::test::require_ok;

namespace {

constexpr std::chrono::nanoseconds first_decision = std::chrono::seconds(1'769'860'800);

/// Would colour, overwrite and title a terminal that it reached raw.
const std::string hostile = "a gate said \x1b[31mno\x1b[0m\r\x1b]0;title\x07 \u009b2J\u202e \"quoted\" \\ \xc3\xa4";

CalibrationRecord next_record(const CalibrationRecord& before, Decision decision, const Vector6& knock) {
  CalibrationRecord record = before;
  ++record.sequence;
  record.decision = decision;
  record.T_camera_lidar_before = before.T_camera_lidar;
  record.T_camera_lidar = before.T_camera_lidar * perturbation(knock);
  record.wall_time += std::chrono::minutes(1);
  record.boot_time += std::chrono::minutes(1);
  return record;
}

std::vector<CalibrationRecord> three_records() {
  CalibrationRecord first;
  first.vehicle = "demo-car";
  first.pair = "front";
  first.sequence = 1;
  first.reason = "taken from the configuration";
  first.asked_by = "configuration";
  first.T_camera_lidar.linear() << 0, -1, 0, 0, 0, -1, 1, 0, 0;
  first.T_camera_lidar.translation() << 0.25, -0.08, 0.5;
  first.T_camera_lidar_before = first.T_camera_lidar;
  first.configuration_sha256 = sha256_hex("configuration");
  first.software_version = "1.2.3";
  first.software_sha256 = sha256_hex("software");
  first.evidence_sha256 = sha256_hex("evidence");
  first.wall_time = first_decision;
  first.boot_id = "0c9e7a54-6f5e-4a52-9f0a-7c57a6f0f9ab";
  first.boot_time = std::chrono::seconds(100);

  CalibrationRecord rejected = next_record(first, Decision::rejected, Vector6::Zero());
  rejected.asked_by = "uid:1000";
  rejected.reason = hostile;

  Vector6 knock;
  knock << -0.25 * radians_per_degree, 0, 0.5 * radians_per_degree, 0.012, 0, -0.034;
  CalibrationRecord accepted = next_record(rejected, Decision::accepted, knock);
  accepted.asked_by = "calibd";
  accepted.reason = "better on the pairs held back";
  accepted.sigma = Vector6::Constant(0.001);
  accepted.score = CalibrationRecord::Score{0.25, 0.3125, 0.2, 0.28};
  accepted.frame_stamps_ns = {1317046453072943000, 1317046453176219000};
  return {first, rejected, accepted};
}

CalibrationRecord baseline_record(const CalibrationRecord& in_force) {
  CalibrationRecord record = next_record(in_force, Decision::baseline, Vector6::Zero());
  record.T_camera_lidar = record.T_camera_lidar_before = in_force.T_camera_lidar;
  record.reason = "the baseline was learned from 20 pairs";
  record.sigma.reset();
  record.score.reset();
  record.frame_stamps_ns.clear();
  record.baseline = CalibrationRecord::Baseline{.pairs = 20,
                                                .slope = Vector6::Constant(0.5),
                                                .slope_covariance = 4 * Matrix6::Identity(),
                                                .sensitivity = 100 * Matrix6::Identity(),
                                                .sensitivity_deviation = Vector6::Constant(10),
                                                .prominence = 0.25,
                                                .prominence_deviation = 0.0625,
                                                .score = 1.25,
                                                .score_deviation = 0.0625};
  return record;
}

/// Evidence of this moment, that counts for an hour.
Grounds fresh_grounds() {
  std::ifstream file("/proc/sys/kernel/random/boot_id");
  std::string boot_id;
  std::getline(file, boot_id);
  timespec time{};
  clock_gettime(CLOCK_BOOTTIME, &time);
  return {.pairs = 42,
          .taken = {boot_id, std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec)},
          .lifetime = std::chrono::hours(1),
          .evidence_sha256 = sha256_hex("evidence"),
          .not_written = std::nullopt};
}

Status snapshot(const CalibrationRecord& in_force, const PublicKey& key, Verdict verdict) {
  PairStatus pair;
  pair.name = in_force.pair;
  pair.verdict = verdict;
  pair.reason = hostile;
  pair.grounds = fresh_grounds();
  pair.since = in_force.wall_time;
  pair.last_evaluated = in_force.wall_time + std::chrono::seconds(10);
  pair.evaluated = 42;
  pair.skipped = {{"low_overlap", 3}, {"dark", 1}};
  pair.score = {0.5, 0.25, 0.5};
  pair.misalignment = PairStatus::Misalignment{};
  pair.misalignment->delta << 0.1 * radians_per_degree, -0.2 * radians_per_degree, 0.6 * radians_per_degree, -0.01,
      0.02, 0;
  pair.misalignment->sigma.setConstant(0.001);
  pair.detection_limit.emplace(Vector6::Constant(0.002));
  (*pair.detection_limit)[3] = std::numeric_limits<double>::infinity();
  pair.T_camera_lidar = in_force.T_camera_lidar;
  pair.record = PairStatus::Record{in_force.sequence, key.id_text(), true, in_force.wall_time};
  pair.image = {"/camera/left/image", 0.25};
  pair.cloud = {"/lidar/points", std::nullopt};
  pair.time_difference_ms = -12.5;
  return {in_force.vehicle, true, in_force.software_version, 3661, {pair}, 2, std::nullopt};
}

}  // namespace

int main(int argc, char** argv) try {
  const bool with_baseline = argc == 5 && std::string_view(argv[4]) == "baseline";
  if (argc != 4 && !with_baseline) throw std::runtime_error("usage: write_store KEY FOLDER VERDICT [baseline]");
  const SigningKey key = require_ok(SigningKey::load(argv[1]));
  const std::filesystem::path folder = argv[2];
  Store store = require_ok(Store::open(folder / "calibd.db", Store::Mode::read_write));
  std::string previous_sha256(no_previous_sha256);
  auto records = three_records();
  const CalibrationRecord in_force = records.back();
  if (with_baseline) records.push_back(baseline_record(in_force));
  for (CalibrationRecord record : records) {
    record.previous_sha256 = previous_sha256;
    const SignedRecord bytes = require_ok(sign_record(record, key));
    require_ok(store.append_record(record.sequence, record.pair, bytes));
    previous_sha256 = sha256_hex(bytes.canonical);
  }
  std::ofstream(folder / "status.json")
      << to_json(snapshot(in_force, key.public_key(), require_ok(parse_verdict(argv[3])))).dump() << '\n';
  return 0;
} catch (const std::exception& error) {
  std::cerr << "write_store: " << error.what() << '\n';
  return 1;
}
