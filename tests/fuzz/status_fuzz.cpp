#include "calib/status.hpp"

#include <nlohmann/json.hpp>

#include "fuzz/fuzz.hpp"

namespace calib::fuzz {

std::vector<Octets> seeds() {
  Status status;
  status.vehicle = "demo-car";
  status.running = true;
  status.version = "0.1.0";
  status.uptime_s = 100;
  PairStatus pair;
  pair.name = "front";
  pair.reason = "low_overlap";
  pair.image.topic = "/camera/image";
  pair.cloud.topic = "/lidar/points";
  status.pairs.push_back(pair);
  pair.verdict = Verdict::drifted;
  pair.since = std::chrono::seconds(1'700'000'000);
  pair.last_evaluated = pair.since;
  pair.evaluated = 30;
  pair.skipped = {{"low_overlap", 3}};
  pair.score = PairStatus::Score{0.2, 0.19, 0.21};
  pair.misalignment = PairStatus::Misalignment{Vector6::Constant(0.01), Vector6::Constant(0.001)};
  pair.detection_limit = Vector6::Constant(std::numeric_limits<double>::infinity());
  pair.proposed = PairStatus::Proposed{RigidTransform::Identity(), 4};
  pair.record = PairStatus::Record{3, "0123456789ABCDEF", true, pair.since};
  pair.image.age_s = pair.cloud.age_s = 0.5;
  pair.right_image = pair.depth = pair.motion = pair.image;
  pair.time_difference_ms = 20;
  status.pairs.push_back(pair);
  return {octets(to_json(status).dump())};
}

/// As it goes to the snapshot and over the control socket.
std::string written(const Status& status) {
  return to_json(status).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace calib::fuzz

/// What is taken can be written, and is taken again.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  const auto json = nlohmann::json::parse(bytes, bytes + size, nullptr, /*allow_exceptions=*/false);
  const auto status = calib::parse_status(json);
  if (!status) {
    calib::fuzz::require_code(status.error(), {calib::ErrorCode::malformed_status});
    return 0;
  }
  const auto again = calib::parse_status(nlohmann::json::parse(calib::fuzz::written(*status)));
  calib::fuzz::require(again.has_value() && again->pairs.size() == status->pairs.size());
  for (std::size_t i = 0; i < status->pairs.size(); ++i)
    calib::fuzz::require(again->pairs[i].verdict == status->pairs[i].verdict &&
                         again->pairs[i].since.count() / 1'000'000 == status->pairs[i].since.count() / 1'000'000);
  return 0;
}
