#include "pair_watch.hpp"

#include "baseline_record.hpp"
#include "message_ids.hpp"

namespace calib {
namespace {

PairMonitorSettings monitor_settings(const Config& config, const PairConfig& pair) {
  PairMonitorSettings settings;
  settings.frames = pair.recalibration.frames;
  settings.bounds = {pair.recalibration.max_rotation_rad, pair.recalibration.max_translation_m};
  settings.quality.depth_range = pair.depth_range;
  if (pair.motion) settings.quality.max_turn_rad = pair.motion->max_turn_rad;
  settings.depth_is_guessed = std::holds_alternative<OnnxDepthConfig>(pair.depth);
  settings.drift = usual_drift_settings(settings.depth_is_guessed);
  settings.drift.baseline_pairs = pair.drift.baseline_pairs;
  settings.drift.max_baseline_pairs = std::max(settings.drift.max_baseline_pairs, pair.drift.baseline_pairs);
  settings.drift.false_alarms_per_pair = false_alarms_per_pair(config, pair.drift);
  settings.drift.must_notice_rotation_rad = pair.drift.must_notice_rad;
  return settings;
}

/// The signed baseline of the extrinsic in force, if it is of the time since it came into force or before it was put in
/// force again, and was learned with what evidence is measured with now.
const CalibrationRecord* known_baseline(const PairConfig& pair, const Ledger& ledger,
                                        const std::string& evidence_sha256) {
  const CalibrationRecord* known = ledger.baseline(pair.name);
  if (known == nullptr || known->evidence_sha256 != evidence_sha256) return nullptr;
  const CalibrationRecord* in_force = ledger.in_force(pair.name);
  return known->sequence > in_force->sequence || in_force->decision == Decision::rolled_back ? known : nullptr;
}

Verdict shown(DriftVerdict verdict) {
  switch (verdict) {
    case DriftVerdict::learning:
    case DriftVerdict::blind:
      return Verdict::not_evaluated;
    case DriftVerdict::calibrated:
      return Verdict::calibrated;
    case DriftVerdict::suspect:
      return Verdict::suspect;
    case DriftVerdict::drifted:
      return Verdict::drifted;
  }
  return Verdict::not_evaluated;
}

/// Whether the extrinsic in force has stood its probation: its baseline is signed at the end of that.
bool has_stood_probation(const PairConfig& pair, const Ledger& ledger) {
  const CalibrationRecord* in_force = ledger.in_force(pair.name);
  const CalibrationRecord* baseline = ledger.baseline(pair.name);
  return in_force->decision != Decision::accepted || (baseline != nullptr && baseline->sequence > in_force->sequence);
}

/// Evidence, as the records alone tell it, in the place of that of `state`, whose other contents stay.
void set_evidence_aside(PairState& state, const PairConfig& pair, const Ledger& ledger,
                        const std::string& evidence_sha256) {
  // What is learned anew at an extrinsic that was wrong would be what is normal there.
  if (shown(state.drift.verdict) == Verdict::drifted)
    state.unresolved = "it was drifted before its evidence was set aside";
  state.evidence_sha256 = evidence_sha256;
  state.drift = {};
  state.score.reset();
  state.proposed_record.reset();
  if (state.probation) state.probation.emplace();
  if (const CalibrationRecord* known = known_baseline(pair, ledger, evidence_sha256))
    state.drift = learned_state(*known->baseline);
}

/// What a message was refused for was counted message by message.
bool counted_on_arrival(ErrorCode code) {
  return is_malformed(code) || code == ErrorCode::image_size_mismatch || code == ErrorCode::out_of_memory;
}

std::string_view message_id(const PairState& state) {
  switch (state.verdict) {
    case Verdict::drifted:
      return message_ids::drifted;
    case Verdict::suspect:
      return message_ids::drift_suspected;
    case Verdict::calibrated:
      return message_ids::cleared;
    case Verdict::not_evaluated:
      break;
  }
  return state.reason.starts_with("sensor_silent") ? message_ids::sensor_silent : message_ids::not_evaluated;
}

}  // namespace

PairWatch::PairWatch(const Config& config, const PairConfig& pair, std::string evidence_sha256, PairMonitor monitor,
                     PairState state, Ledger& ledger, Clock clock, PairListener listener)
    : config_(config),
      pair_(pair),
      monitor_(std::move(monitor)),
      state_(std::move(state)),
      ledger_(ledger),
      clock_(std::move(clock)),
      listener_(std::move(listener)),
      evidence_sha256_(std::move(evidence_sha256)) {}

Result<std::unique_ptr<PairWatch>> PairWatch::take_over(const Config& config, const PairConfig& pair,
                                                        std::string evidence_sha256,
                                                        std::unique_ptr<DepthEstimator> depth, Ledger& ledger,
                                                        Clock clock, PairListener listener) {
  const CalibrationRecord* initial = ledger.initial(pair.name);
  const auto saved = ledger.state(pair.name);
  PairState state;
  state.since = clock().wall;
  state.evidence_sha256 = evidence_sha256;
  std::string set_aside;
  if (initial == nullptr || !same(initial->T_camera_lidar, pair.T_camera_lidar)) {
    CalibrationRecord record;
    record.decision = Decision::initial;
    record.asked_by = "configuration";
    record.reason = "taken from the configuration";
    record.evidence_sha256 = evidence_sha256;
    record.T_camera_lidar = pair.T_camera_lidar;
    record.T_camera_lidar_before =
        initial != nullptr ? ledger.in_force(pair.name)->T_camera_lidar : pair.T_camera_lidar;
    const auto written = ledger.write(pair.name, state, {.record = std::move(record), .alert = {}}, clock());
    if (!written) return propagate(written);
  } else if (!saved && saved.error().code != ErrorCode::malformed_state) {
    return propagate(saved);  // it may well be there
  } else if (saved && *saved) {
    state = **saved;
    if (state.evidence_sha256 != evidence_sha256) {
      set_aside = "it was gathered with another configuration, depth model or calibd";
      set_evidence_aside(state, pair, ledger, evidence_sha256);
    }
  } else {
    set_aside = saved ? "the store holds none" : saved.error().context;
    set_evidence_aside(state, pair, ledger, evidence_sha256);
    if (!has_stood_probation(pair, ledger)) state.probation.emplace();
  }
  PairMonitor monitor(monitor_settings(config, pair), pair.camera.camera, std::move(depth),
                      ledger.in_force(pair.name)->T_camera_lidar, state.drift);
  std::unique_ptr<PairWatch> watch(new PairWatch(config, pair, std::move(evidence_sha256), std::move(monitor),
                                                 std::move(state), ledger, std::move(clock), std::move(listener)));
  watch->begin(set_aside);
  return watch;
}

/// Nothing is claimed before this process has evidence of its own; what was claimed before is said with the reason.
void PairWatch::begin(const std::string& set_aside) {
  if (!set_aside.empty())
    listener_.journal(4, message_ids::evidence_set_aside,
                      name() + ": earlier evidence is set aside: " + set_aside +
                          (state_.drift.baseline.pairs > 0 ? "; the baseline is that of the records"
                                                           : "; the baseline is learned anew"));
  PairState after = state_;
  const Claim now_said = claim({state_.verdict, state_.reason}, std::nullopt, boot_time());
  if (after.verdict == now_said.verdict && set_aside.empty()) return;
  after.verdict = now_said.verdict;
  after.reason = now_said.reason;
  if (!set_aside.empty()) {
    after.reason = "starting: earlier evidence is set aside: " + set_aside;
    if (state_.verdict != after.verdict)
      after.reason += "; it was " + std::string(to_string(state_.verdict)) + " when last evaluated";
  }
  write(std::move(after), std::nullopt);
}

Result<void> PairWatch::evaluate(const FramePair& pair) {
  const Moment taken = clock_();
  auto evidence = monitor_.measure(pair);
  if (!evidence) return propagate(evidence);
  state_.last_stamp = pair.image.stamp;
  observe(std::move(*evidence), taken);
  return {};
}

void PairWatch::observe(PairMonitor::Evidence evidence, const Moment& taken) {
  state_.last_evaluated = clock_().wall;
  ++state_.evaluated;
  const Stencil stencil = evidence.stencil;
  monitor_.observe(std::move(evidence));
  const DriftBaseline& baseline = monitor_.drift().state().baseline;
  state_.score = PairStatus::Score{stencil.current, stencil.best_neighbour(),
                                   baseline.pairs > 0 ? std::optional(baseline.score) : std::nullopt};
  if (state_.probation)
    state_.probation->add(stencil.current - monitor_.score_of_latest(ledger_.in_force(name())->T_camera_lidar_before));
  // Last: what was thrown before leaves no evidence.
  windows_without_evidence_ = 0;
  ++pairs_;
  taken_ = {ledger_.provenance().boot_id, taken.since_boot};
}

void PairWatch::skip(const Error& error, int windows) {
  windows_without_evidence_ += windows;
  last_skip_ = std::string(to_string(error.code)) + ": " + escape_control(error.context);
  if (!counted_on_arrival(error.code)) count_skipped(error.code);
}

void PairWatch::conclude() {
  const auto time = clock_().since_boot;
  if (last_window_) cycles_ = {time - *last_window_, cycles_[0]};
  last_window_ = time;
  // The window's evidence was about the extrinsic that was in force.
  if (state_.probation && windows_without_evidence_ == 0 && !stands_probation()) return;
  auto baseline = baseline_due();
  const std::string learned = baseline ? baseline->reason + ", record " + std::to_string(ledger_.next_sequence()) : "";
  if (write(concluded(), std::move(baseline)) && !learned.empty())
    listener_.journal(5, message_ids::baseline_learned, name() + ": " + learned);

  const bool wanted = state_.verdict == Verdict::drifted && !state_.proposed_record && !state_.probation;
  if (!wanted || !may_recalibrate() || !monitor_.can_recalibrate()) return;
  [[maybe_unused]] const auto told = recalibrate("calibd", /*dry_run=*/false);
  last_window_ = clock_().since_boot;  // a recalibration is no part of the cycle
}

std::optional<std::string> PairWatch::not_written() const {
  const auto& failure = store_failure_ ? store_failure_ : ledger_.head_failure();
  return failure ? std::optional(failure->context) : std::nullopt;
}

std::optional<Grounds> PairWatch::grounds(std::optional<std::string> not_written) const {
  if (pairs_ == 0 && !not_written) return std::nullopt;
  // The shorter one: a lone delay does not make evidence last longer.
  constexpr std::chrono::nanoseconds longest_cycle = std::chrono::minutes(2);
  const auto cycle = std::min({cycles_[0], cycles_[1], longest_cycle});
  return Grounds{.pairs = pairs_,
                 .taken = taken_,
                 .lifetime = evidence_lifetime(config_.sampling, cycle),
                 .evidence_sha256 = evidence_sha256_,
                 .not_written = std::move(not_written)};
}

/// The state with the verdict that the evidence calls for.
PairState PairWatch::concluded() const {
  PairState after = state_;
  after.drift = monitor_.drift().state();
  if (windows_without_evidence_ >= windows_to_stale) {
    after.verdict = Verdict::not_evaluated;
    after.reason = last_skip_;
    // Silence heals nothing.
    if (const Verdict last = shown(after.drift.verdict); last == Verdict::drifted || last == Verdict::suspect)
      after.reason += "; it was " + std::string(to_string(last)) + " when last evaluated";
  } else if (windows_without_evidence_ == 0) {
    after.verdict = shown(after.drift.verdict);
    after.reason = monitor_.drift().reason();
    if (after.verdict == Verdict::drifted)
      after.reason += "; pairs for recalibration: " + monitor_.progress() + patience();
    if (after.probation)
      after.reason +=
          "; the extrinsic of record " + std::to_string(ledger_.in_force(name())->sequence) + " is on probation";
  }
  if (after.unresolved && after.verdict == Verdict::calibrated) {
    after.verdict = Verdict::not_evaluated;
    after.reason = "unresolved: " + *after.unresolved + ", and what was learned since may be of an extrinsic that is " +
                   "wrong; recalibrate, or confirm it with `calibctl rollback " + name() + " --to " +
                   std::to_string(ledger_.in_force(name())->sequence) + "`";
  }
  // The state itself is about to be written.
  const auto& head = ledger_.head_failure();
  const auto not_remembered = head ? std::optional(head->context) : std::nullopt;
  Claim said = claim({after.verdict, std::move(after.reason)}, grounds(not_remembered), boot_time());
  after.verdict = said.verdict;
  after.reason = std::move(said.reason);
  return after;
}

/// The record to sign once the baseline is known, and again once nothing is added to it any more.
std::optional<CalibrationRecord> PairWatch::baseline_due() const {
  const DriftBaseline& learned = monitor_.drift().state().baseline;
  const DriftSettings& settings = monitor_.drift().settings();
  const CalibrationRecord* const last = known_baseline(pair_, ledger_, evidence_sha256_);
  const int known = last == nullptr ? 0 : static_cast<int>(last->baseline->pairs);
  const int due = known < settings.baseline_pairs ? settings.baseline_pairs : settings.max_baseline_pairs;
  if (learned.pairs < due || known >= due) return std::nullopt;
  CalibrationRecord record;
  record.decision = Decision::baseline;
  record.asked_by = "calibd";
  record.reason = "what is normal at the extrinsic of record " + std::to_string(ledger_.in_force(name())->sequence) +
                  " was learned from " + std::to_string(learned.pairs) + " pairs";
  record.T_camera_lidar = record.T_camera_lidar_before = monitor_.T_camera_lidar();
  record.baseline = recorded(learned);
  return record;
}

DriftAlert PairWatch::alert(const PairState& after) const {
  DriftAlert alert;
  alert.stamp = clock_().wall;
  alert.vehicle = config_.vehicle;
  alert.pair = name();
  alert.verdict = after.verdict;
  alert.previous_verdict = state_.verdict;
  alert.reason = after.reason;
  if (const auto estimate = monitor_.drift().misalignment()) alert.misalignment = {estimate->delta, estimate->sigma()};
  alert.record_sequence = ledger_.in_force(name())->sequence;
  return alert;
}

/// Makes `after` the pair's state, durably, with the record and the alert that go with it; or changes nothing. `adopt`
/// is called once that is done, before anybody is told.
bool PairWatch::write(PairState after, std::optional<CalibrationRecord> record, const std::function<void()>& adopt) {
  if (record) record->evidence_sha256 = evidence_sha256_;
  Ledger::Entry entry{.record = std::move(record), .alert = {}};
  const Verdict before = state_.verdict;
  if (after.verdict != before) {
    after.since = clock_().wall;
    entry.alert = alert(after);
  }
  const auto written = ledger_.write(name(), after, std::move(entry), clock_());
  if (!written) {
    const bool news = !store_failure_ || store_failure_->code != written.error().code;
    store_failure_ = written.error();
    if (news)
      listener_.journal(3, message_ids::store_failed,
                        name() + ": " + store_failure_->context +
                            "; nothing was changed, the pair is not evaluated, and the next window tries again");
    return false;
  }
  if (std::exchange(store_failure_, std::nullopt))
    listener_.journal(5, message_ids::store_failed, name() + ": the store can be written again");
  state_ = std::move(after);
  if (adopt) adopt();
  if (!written->alert) return true;
  listener_.alert(*written->alert);
  const bool cleared = state_.verdict == Verdict::calibrated || state_.verdict == Verdict::not_evaluated;
  listener_.journal(cleared ? 5 : 4, message_id(state_),
                    name() + ": " + std::string(to_string(state_.verdict)) + " (was " + std::string(to_string(before)) +
                        "): " + state_.reason);
  return true;
}

PairStatus PairWatch::status() const {
  PairStatus status;
  status.name = name();
  status.grounds = grounds(not_written());
  Claim said = claim({state_.verdict, state_.reason}, status.grounds, boot_time());
  status.verdict = said.verdict;
  status.reason = std::move(said.reason);
  status.since = state_.since;
  status.last_evaluated = state_.last_evaluated;
  status.evaluated = state_.evaluated;
  status.skipped = state_.skipped;
  status.score = state_.score;
  const DriftMonitor& drift = monitor_.drift();
  if (const auto estimate = drift.misalignment())
    status.misalignment = PairStatus::Misalignment{estimate->delta, estimate->sigma()};
  if (drift.learned()) {
    status.noticeable.emplace();
    for (int axis = 0; axis < 6; ++axis) (*status.noticeable)[axis] = drift.noticeable_shift(axis);
  }
  status.T_camera_lidar = monitor_.T_camera_lidar();
  if (state_.proposed_record)
    if (const auto proposal = ledger_.find(name(), *state_.proposed_record))
      status.proposed = PairStatus::Proposed{proposal->T_camera_lidar, proposal->sequence};
  // Every record was verified when the ledger was opened, or signed by this very process.
  const CalibrationRecord* record = ledger_.in_force(name());
  status.record = PairStatus::Record{record->sequence, ledger_.key_id(), true, record->wall_time};
  return status;
}

std::optional<RigidTransform> PairWatch::computed_extrinsic() const {
  if (state_.proposed_record)
    if (const auto proposal = ledger_.find(name(), *state_.proposed_record)) return proposal->T_camera_lidar;
  if (ledger_.in_force(name())->decision != Decision::initial) return monitor_.T_camera_lidar();
  return std::nullopt;
}

}  // namespace calib
