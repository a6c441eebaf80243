#include "ledger.hpp"

#include <algorithm>
#include <nlohmann/json.hpp>

namespace calib {
namespace {

using nlohmann::json;

/// The form of proto/alert.schema.json.
std::string alert_text(const DriftAlert& alert) {
  const auto three = [](const auto& vector) { return json{vector[0], vector[1], vector[2]}; };
  return json{{"schema", 1},
              {"alert_sequence", alert.alert_sequence},
              {"stamp", rfc3339_ns(alert.stamp)},
              {"vehicle", alert.vehicle},
              {"pair", alert.pair},
              {"verdict", to_string(alert.verdict)},
              {"previous_verdict", to_string(alert.previous_verdict)},
              {"reason", alert.reason},
              {"rotation_rad", three(alert.misalignment.delta.head<3>())},
              {"translation_m", three(alert.misalignment.delta.tail<3>())},
              {"sigma_rotation_rad", three(alert.misalignment.sigma.head<3>())},
              {"sigma_translation_m", three(alert.misalignment.sigma.tail<3>())},
              {"record_sequence", alert.record_sequence}}
      .dump(-1, ' ', false, json::error_handler_t::replace);  // a reason may quote what came over the network
}

Vector6 six(const json& first, const json& last) {
  Vector6 values;
  for (int i = 0; i < 3; ++i) {
    values[i] = first.at(i).get<double>();
    values[i + 3] = last.at(i).get<double>();
  }
  return values;
}

Result<DriftAlert> parse_alert(std::string_view text) {
  try {
    const json in = json::parse(text);
    DriftAlert alert;
    alert.alert_sequence = in.at("alert_sequence").get<std::uint64_t>();
    alert.stamp = parse_rfc3339(in.at("stamp").get<std::string>()).value();
    alert.vehicle = in.at("vehicle").get<std::string>();
    alert.pair = in.at("pair").get<std::string>();
    alert.verdict = parse_verdict(in.at("verdict").get<std::string>()).value();
    alert.previous_verdict = parse_verdict(in.at("previous_verdict").get<std::string>()).value();
    alert.reason = in.at("reason").get<std::string>();
    alert.misalignment.delta = six(in.at("rotation_rad"), in.at("translation_m"));
    alert.misalignment.sigma = six(in.at("sigma_rotation_rad"), in.at("sigma_translation_m"));
    alert.record_sequence = in.at("record_sequence").get<std::uint64_t>();
    return alert;
  } catch (const std::exception& exception) {
    return fail("malformed_alert", std::string("a kept alert cannot be read: ") + exception.what());
  }
}

}  // namespace

bool same(const RigidTransform& a, const RigidTransform& b) {
  const RigidTransform difference = a.inverse() * b;
  return rotation_angle_rad(difference) < 1e-9 && difference.translation().norm() < 1e-9;
}

Ledger::Ledger(Store store, SigningKey key, Provenance provenance)
    : store_(std::move(store)), key_(std::move(key)), provenance_(std::move(provenance)) {}

Result<Ledger> Ledger::open(const std::filesystem::path& state_dir, SigningKey key, Provenance provenance) {
  auto store = Store::open(state_dir / "calibd.db", Store::Mode::read_write);
  if (!store) return tl::unexpected(store.error());
  Ledger ledger(std::move(*store), std::move(key), std::move(provenance));
  auto history = verified_history(ledger.store_, ledger.key_.public_key());
  if (!history) return tl::unexpected(history.error());
  if (!history->empty()) {
    const std::uint64_t last = history->back().sequence;
    const auto signed_record = ledger.store_.record(last);
    if (!signed_record) return tl::unexpected(signed_record.error());
    ledger.last_sequence_ = last;
    ledger.last_sha256_ = sha256_hex(signed_record->canonical);
  }
  for (CalibrationRecord& record : *history) ledger.index(std::move(record));
  return ledger;
}

void Ledger::index(CalibrationRecord record) {
  if (record.decision == Decision::initial) initial_.insert_or_assign(record.pair, record);
  if (record.decision == Decision::baseline) baselines_[record.pair].push_back(record);
  if (puts_in_force(record.decision)) extrinsics_[record.pair].push_back(std::move(record));
}

const CalibrationRecord* Ledger::in_force(std::string_view pair) const {
  const auto found = extrinsics_.find(pair);
  return found == extrinsics_.end() ? nullptr : &found->second.back();
}

const CalibrationRecord* Ledger::before_in_force(std::string_view pair) const {
  const auto found = extrinsics_.find(pair);
  return found == extrinsics_.end() || found->second.size() < 2 ? nullptr : &found->second[found->second.size() - 2];
}

const CalibrationRecord* Ledger::initial(std::string_view pair) const {
  const auto found = initial_.find(pair);
  return found == initial_.end() ? nullptr : &found->second;
}

const CalibrationRecord* Ledger::baseline(std::string_view pair, const RigidTransform& T_camera_lidar) const {
  const auto found = baselines_.find(pair);
  if (found == baselines_.end()) return nullptr;
  const auto& all = found->second;
  const auto of_it = std::find_if(all.rbegin(), all.rend(), [&](const CalibrationRecord& record) {
    return same(record.T_camera_lidar, T_camera_lidar);
  });
  return of_it == all.rend() ? nullptr : &*of_it;
}

const CalibrationRecord* Ledger::baseline(std::string_view pair) const {
  const CalibrationRecord* const now = in_force(pair);
  return now == nullptr ? nullptr : baseline(pair, now->T_camera_lidar);
}

Result<CalibrationRecord> Ledger::find(std::string_view pair, std::uint64_t sequence) const {
  const auto signed_record = store_.record(sequence);
  if (!signed_record) return tl::unexpected(signed_record.error());
  std::string previous_sha256{no_previous_sha256};
  if (sequence > 1) {
    const auto previous = store_.record(sequence - 1);
    if (!previous) return tl::unexpected(previous.error());
    previous_sha256 = sha256_hex(previous->canonical);
  }
  auto record = verify_record(*signed_record, key_.public_key(), previous_sha256, sequence);
  if (record && record->pair != pair)
    return fail("record_not_found", "record " + std::to_string(sequence) + " is not of pair " + std::string(pair));
  return record;
}

Result<Ledger::Written> Ledger::write(std::string_view pair, const PairState& state, Entry entry, const Moment& now) {
  Written written{std::move(entry.record), std::move(entry.alert)};
  std::string record_sha256;
  const auto done = store_.in_transaction([&]() -> Result<void> {
    if (written.record) {
      CalibrationRecord& record = *written.record;
      record.vehicle = provenance_.vehicle;
      record.pair = pair;
      record.sequence = last_sequence_ + 1;
      record.previous_sha256 = last_sha256_;
      record.configuration_sha256 = provenance_.configuration_sha256;
      record.software_version = provenance_.software_version;
      record.software_sha256 = provenance_.software_sha256;
      record.boot_id = provenance_.boot_id;
      record.wall_time = now.wall;
      record.boot_time = now.since_boot;
      const auto signed_record = sign_record(record, key_);
      if (!signed_record) return tl::unexpected(signed_record.error());
      record_sha256 = sha256_hex(signed_record->canonical);
      // What is written is what is in force: to the last bit the same as after a restart.
      auto as_written = parse_record(signed_record->canonical);
      if (!as_written) return tl::unexpected(as_written.error());
      record = std::move(*as_written);
      if (auto appended = store_.append_record(record.sequence, pair, *signed_record); !appended) return appended;
    }
    if (written.alert) {
      const auto sequence = store_.next_alert_sequence();
      if (!sequence) return tl::unexpected(sequence.error());
      written.alert->alert_sequence = *sequence;
      if (auto queued = store_.enqueue_alert(alert_text(*written.alert)); !queued)
        return tl::unexpected(queued.error());
    }
    return store_.save_state(pair, to_text(state));
  });
  if (!done) return tl::unexpected(done.error());
  if (written.record) {
    last_sequence_ = written.record->sequence;
    last_sha256_ = record_sha256;
    index(*written.record);
  }
  return written;
}

Result<std::optional<PairState>> Ledger::state(std::string_view pair) const {
  const auto text = store_.state(pair);
  if (!text) return tl::unexpected(text.error());
  if (!*text) return std::optional<PairState>{};
  auto state = parse_pair_state(**text);
  if (!state) return tl::unexpected(state.error());
  return std::optional<PairState>(std::move(*state));
}

Result<std::vector<DriftAlert>> Ledger::waiting_alerts(std::size_t limit) const {
  const auto waiting = store_.waiting_alerts(limit);
  if (!waiting) return tl::unexpected(waiting.error());
  std::vector<DriftAlert> alerts;
  for (const Store::Alert& one : *waiting) {
    auto alert = parse_alert(one.json);
    if (!alert) return tl::unexpected(alert.error());
    alerts.push_back(std::move(*alert));
  }
  return alerts;
}

std::uint64_t Ledger::waiting_alert_count() const { return store_.waiting_alert_count().value_or(0); }

}  // namespace calib
