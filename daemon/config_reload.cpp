#include "config_reload.hpp"

#include <algorithm>
#include <array>
#include <set>

#include "calib/sha256.hpp"

namespace calib {
namespace {

/// What follows `pairs[N].` in `key`; empty for a key that is not of a pair.
std::string_view key_in_pair(std::string_view key) {
  const std::size_t end = key.find("].");
  return key.starts_with("pairs[") && end != std::string_view::npos ? key.substr(end + 2) : "";
}

/// Whether calibd may go on with its state when this changes. It is what `PairConfig::evidence_text` leaves out, less
/// what a pair is made of at the start.
bool may_change(std::string_view key) {
  constexpr std::array<std::string_view, 2> of_all{"sampling.period", "sampling.window"};
  constexpr std::array<std::string_view, 8> of_pair{
      "drift.baseline_pairs",         "drift.false_alerts_per_1000_vehicle_weeks",
      "drift.driving_hours_per_week", "drift.must_notice_deg",
      "drift.notice_within",          "recalibration.mode",
      "recalibration.frames",         "recalibration.min_interval"};
  return std::ranges::find(of_all, key) != of_all.end() ||
         std::ranges::find(of_pair, key_in_pair(key)) != of_pair.end();
}

bool has_same_pairs(const Config& one, const Config& other) {
  return std::ranges::equal(one.pairs, other.pairs, {}, &PairConfig::name, &PairConfig::name);
}

void take_over(const PairConfig& wanted, PairConfig& running) {
  const auto min_scene_change = running.drift.min_scene_change;
  running.drift = wanted.drift;
  running.drift.min_scene_change = min_scene_change;
  running.recalibration.mode = wanted.recalibration.mode;
  running.recalibration.frames = wanted.recalibration.frames;
  running.recalibration.min_interval = wanted.recalibration.min_interval;
}

}  // namespace

ConfigChanges take_over(const Config& wanted, Config& running) {
  std::set<std::string> keys;
  for (const auto& [key, value] : wanted.values) keys.insert(key);
  for (const auto& [key, value] : running.values) keys.insert(key);
  const auto value_in = [](const Config& config, const std::string& key) {
    const auto found = config.values.find(key);
    return found == config.values.end() ? std::nullopt : std::optional(found->second);
  };
  const bool same_pairs = has_same_pairs(wanted, running);
  ConfigChanges changes;
  for (const std::string& key : keys) {
    const auto value = value_in(wanted, key);
    if (value == value_in(running, key)) continue;
    const bool of_pair = key.starts_with("pairs");
    if (of_pair && !same_pairs) continue;
    if (!may_change(key)) {
      changes.need_restart.push_back(key);
      continue;
    }
    changes.taken_over.push_back(key);
    if (value)
      running.values[key] = *value;
    else
      running.values.erase(key);
  }
  if (!same_pairs) changes.need_restart.emplace_back("pairs");
  running.sampling.period = wanted.sampling.period;
  running.sampling.window = wanted.sampling.window;
  if (same_pairs)
    for (std::size_t i = 0; i < running.pairs.size(); ++i) take_over(wanted.pairs[i], running.pairs[i]);
  if (changes.need_restart.empty())
    running.sha256 = wanted.sha256;
  else if (!changes.taken_over.empty())
    running.sha256 = sha256_hex(running.sha256 + '\n' + wanted.sha256 + '\n');
  return changes;
}

}  // namespace calib
