#include "record_check.hpp"

#include "stored_records.hpp"

namespace calib::ctl {
namespace {

bool same(const RigidTransform& a, const RigidTransform& b) {
  // Not zero: JSON and the conversion of a quaternion to a matrix round the last bits.
  constexpr double tolerance = 1e-9;
  const RigidTransform difference = a.inverse() * b;
  return rotation_angle_rad(difference) < tolerance && difference.translation().norm() < tolerance;
}

RecordCheck check(const PairStatus& pair, const Chain& chain) {
  const std::uint64_t sequence = pair.record->sequence;
  if (sequence == 0 || sequence > chain.verified.size())
    return {true, false, chain.broken ? chain.broken->context : "the store does not hold this record"};
  const CalibrationRecord& record = chain.verified[sequence - 1].record;
  if (record.pair != pair.name)
    return {true, false, "record " + std::to_string(sequence) + " belongs to pair " + record.pair};
  if (!puts_in_force(record.decision))
    return {true, false,
            "record " + std::to_string(sequence) + " puts nothing in force: it is " +
                std::string(to_string(record.decision))};
  if (!same(record.T_camera_lidar, pair.T_camera_lidar))
    return {true, false, "the extrinsic in use is not the one of record " + std::to_string(sequence)};
  return {true, true, "verified"};
}

}  // namespace

std::vector<RecordCheck> check_records(const Status& status, const Paths& paths) {
  // A status does not request all records from the daemon.
  const auto verified = only_daemon_may_read(paths)
                            ? Result<Chain>(fail(ErrorCode::denied,
                                                 "only calibd and root may read the store; `calibctl verify` "
                                                 "requests the records from calibd"))
                            : read_chain(paths);
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
