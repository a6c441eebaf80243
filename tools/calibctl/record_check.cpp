#include "record_check.hpp"

#include <map>

namespace calib::ctl {
namespace {

/// What calibctl could verify by itself.
struct VerifiedRecords {
  std::map<std::uint64_t, CalibrationRecord> records;
  /// Why the chain ends where it ends, when that is not its end.
  std::optional<Error> broken;
};

Result<VerifiedRecords> read_verified(const Places& places) {
  const auto key = load_public_key(places.public_key);
  if (!key) return tl::unexpected(key.error());
  const auto store = open_store(places);
  if (!store) return tl::unexpected(store.error());
  VerifiedRecords found;
  const auto all = visit_verified(*store, *key, [&](const CalibrationRecord& record, const SignedRecord&) {
    found.records.emplace(record.sequence, record);
  });
  if (!all && all.error().code == "store_failed") return tl::unexpected(all.error());
  if (!all) found.broken = all.error();
  return found;
}

bool same(const RigidTransform& a, const RigidTransform& b) {
  // Not zero: JSON, and a quaternion on its way through a matrix, cost some last bits.
  constexpr double tolerance = 1e-9;
  const RigidTransform difference = a.inverse() * b;
  return rotation_angle_rad(difference) < tolerance && difference.translation().norm() < tolerance;
}

RecordCheck check(const PairStatus& pair, const VerifiedRecords& verified) {
  const std::uint64_t sequence = pair.record->sequence;
  const auto found = verified.records.find(sequence);
  if (found == verified.records.end())
    return {true, false, verified.broken ? verified.broken->context : "the store does not hold this record"};
  const CalibrationRecord& record = found->second;
  if (record.pair != pair.name)
    return {true, false, "record " + std::to_string(sequence) + " is of pair " + record.pair};
  if (!puts_in_force(record.decision))
    return {true, false,
            "record " + std::to_string(sequence) + " puts nothing in force: it is " +
                std::string(to_string(record.decision))};
  if (!same(record.T_camera_lidar, pair.T_camera_lidar))
    return {true, false, "the extrinsic in use is not the one of record " + std::to_string(sequence)};
  return {true, true, "verified"};
}

}  // namespace

Result<Store> open_store(const Places& places) {
  for (const char* suffix : {"", "-wal", "-shm", "-journal"}) {
    std::filesystem::path file = places.store();
    file += suffix;
    std::error_code error;
    const auto status = std::filesystem::status(file, error);
    if (std::filesystem::exists(status) && !std::filesystem::is_regular_file(status))
      return fail("store_failed", file.string() + " is no regular file");
  }
  return Store::open(places.store(), Store::Mode::read_only);
}

std::vector<RecordCheck> check_records(const Status& status, const Places& places) {
  const auto verified = read_verified(places);
  std::vector<RecordCheck> checks;
  for (const PairStatus& pair : status.pairs) {
    if (!pair.record)
      checks.push_back({true, false, "none"});
    else if (verified)
      checks.push_back(check(pair, *verified));
    else
      checks.push_back(
          {false, status.running && pair.record->verified, "not checked by calibctl: " + verified.error().context});
  }
  return checks;
}

}  // namespace calib::ctl
