#include "service.hpp"

#include <algorithm>

#include "message_ids.hpp"
#include "pair_topics.hpp"

namespace calib {

using namespace std::chrono_literals;
using std::chrono::steady_clock;

std::string evidence_sha256(const PairConfig& pair, const Provenance& provenance) {
  return sha256_hex(pair.evidence_text + "software:" + provenance.software_sha256 + '\n' + pinned_text(pair.depth));
}

Service::Service(Config config, Ledger ledger, std::unique_ptr<Network> network, Surroundings surroundings)
    : config_(std::move(config)),
      ledger_(std::move(ledger)),
      network_(std::move(network)),
      surroundings_(std::move(surroundings)),
      started_(surroundings_.clock().since_boot) {}

Result<std::unique_ptr<Service>> Service::make(Config config, Ledger ledger, std::unique_ptr<Network> network,
                                               Surroundings surroundings) {
  std::unique_ptr<Service> service(
      new Service(std::move(config), std::move(ledger), std::move(network), std::move(surroundings)));
  for (PairConfig& pair : service->config_.pairs)
    if (auto pinned = pin_files(pair.depth); !pinned) return propagate(pinned);
  const auto& log = service->surroundings_.log;
  if (const auto& missing = service->ledger_.records_missing())
    log(3, message_ids::records_missing, *missing + "; calibd goes on with the records that there are");
  if (const auto& refused = service->ledger_.signing_refused())
    log(3, message_ids::signing_refused,
        "signing is refused: " + *refused + "; calibd watches, and decides nothing that needs a record");
  if (const auto& failure = service->ledger_.evidence_failure())
    log(4, message_ids::evidence_set_aside, failure->context + "; calibd goes on from the last decision of each pair");
  // Alerts that were written but perhaps not sent, and extrinsics that late readers must see.
  const auto latest = service->ledger_.latest_alerts(32);
  if (!latest) return propagate(latest);
  for (const Error& unreadable : latest->unreadable)
    log(4, message_ids::store_failed, unreadable.context + "; it is left where it is, and not sent");
  for (const DriftAlert& alert : latest->alerts)
    if (auto sent = service->network_->publish_alert(alert); !sent) return propagate(sent);
  for (const PairConfig& pair : service->config_.pairs)
    if (auto restored = service->restore(pair); !restored) return propagate(restored);
  service->publish_extrinsics();
  service->collect_status();
  return service;
}

Result<void> Service::restore(const PairConfig& config) {
  PairPipeline pipeline(pair_settings(config_, config, evidence_sha256(config, ledger_.provenance())));
  auto depth = std::make_unique<DepthSource>(
      config, [this] { return keep_going(); }, surroundings_.make_depth);
  auto owned = std::make_unique<Pair>(
      Pair{.config = &config, .topics = topics_of(config), .pipeline = std::move(pipeline), .depth = std::move(depth)});
  Pair& pair = *owned;
  if (config.camera.info) pair.camera_info.windows_to_wait = windows_for_camera_info;
  auto restored = pair.pipeline.restore(ledger_.state(config.name), config.T_camera_lidar, now(pair));
  if (!restored) return propagate(restored);
  if (const auto& entry = restored->set_aside)
    surroundings_.log(entry->priority, entry->message_id, {entry->text, entry->fields});
  const bool is_new = restored->decision.record.has_value();
  pair.state = std::move(restored->state);
  const bool committed = commit(pair, restored->decision);
  if (!committed && is_new) return tl::unexpected(*pair.store_failure);
  if (committed) publish(pair, restored->decision);
  pairs_.push_back(std::move(owned));
  return {};
}

Now Service::now(const Pair& pair) const {
  const auto& head = ledger_.head_failure();
  return {.time = surroundings_.clock(),
          .boot_id = ledger_.provenance().boot_id,
          .history = ledger_.history(pair.config->name),
          .next_sequence = ledger_.next_sequence(),
          .not_written = head ? std::optional(head->context) : std::nullopt,
          .signing_refused = ledger_.signing_refused()};
}

/// Writes what was decided, durably, and makes it the pair's state; or changes nothing and returns false.
bool Service::commit(Pair& pair, PairDecision& decision) {
  const std::string& name = pair.config->name;
  if (pair.store_failure && decision.alert)
    decision.alert->reason += "; before that evidence was lost: " + pair.store_failure->context;
  auto written = ledger_.write(name, *decision.state, {std::move(decision.record), std::move(decision.alert)},
                               surroundings_.clock());
  if (!written) {
    cannot_write(pair, std::move(written.error()));
    return false;
  }
  pair.has_evidence_since = false;
  pair.unsaved_since.reset();
  if (std::exchange(pair.store_failure, std::nullopt))
    surroundings_.log(5, message_ids::store_failed, name + ": the store can be written again");
  decision.record = std::move(written->record);
  decision.alert = std::move(written->alert);
  pair.state = std::move(*decision.state);
  // As its record has it, to the last bit.
  pair.state.put_in_force(*ledger_.history(name).in_force());
  return true;
}

/// Makes evidence alone the pair's state, if it can be written later as far as that can be told without writing.
bool Service::take_evidence(Pair& pair, PairDecision& decision) {
  if (auto writable = ledger_.is_writable(); !writable) {
    cannot_write(pair, std::move(writable.error()));
    return false;
  }
  pair.state = std::move(*decision.state);
  pair.has_evidence_since = true;
  if (!pair.unsaved_since) pair.unsaved_since = surroundings_.clock().since_boot;
  save_evidence_when_due();
  return true;
}

/// By the clock that nobody sets; time in which the machine was suspended counts.
void Service::save_evidence_when_due() {
  const auto time = surroundings_.clock().since_boot;
  if (std::ranges::any_of(pairs_, [&](const auto& pair) {
        return pair->unsaved_since && time - *pair->unsaved_since >= longest_unsaved;
      }))
    save_evidence();
}

void Service::save_evidence() {
  std::map<std::string_view, const PairState*> states;
  bool some_waits = false;
  for (const auto& pair : pairs_) {
    if (pair->has_evidence_since) states.emplace(pair->config->name, &pair->state);
    some_waits = some_waits || pair->unsaved_since;
  }
  if (!some_waits) return;
  const auto written = ledger_.write_evidence(states);
  if (!written && !evidence_file_failed_)
    surroundings_.log(4, message_ids::store_failed,
                      written.error().context + "; evidence is written into the store instead, which writes more");
  evidence_file_failed_ = !written;
  for (const auto& pair : pairs_) {
    if (!pair->unsaved_since) continue;
    pair->unsaved_since.reset();
    if (written) continue;
    auto stored = ledger_.write(pair->config->name, pair->state, {}, surroundings_.clock());
    pair->has_evidence_since = !stored;
    if (stored) continue;
    cannot_write(*pair, std::move(stored.error()));
    pair->unsaved_since = surroundings_.clock().since_boot;  // the pair's next window tries, too
  }
  if (!written) collect_status();
}

/// What is measured from now on is lost, until something can be written again: the verdict has to be confirmed anew,
/// and the next cycle is no measure.
void Service::cannot_write(Pair& pair, Error error) {
  const bool news = !pair.store_failure || pair.store_failure->code != error.code;
  pair.store_failure = std::move(error);
  pair.state.run.pairs = 0;
  pair.state.run.last_window.reset();
  if (news)
    surroundings_.log(3, message_ids::store_failed,
                      {pair.config->name + ": " + pair.store_failure->context +
                           "; nothing was changed, the pair is not evaluated, and the next window tries again",
                       {.pair = pair.config->name,
                        .verdict = std::string(to_string(Verdict::not_evaluated)),
                        .reason = pair.store_failure->context,
                        .cause = std::string(to_string(pair.store_failure->code))}});
}

/// What a committed decision tells the world.
void Service::publish(const Pair& pair, const PairDecision& decision) {
  if (decision.alert)
    if (auto sent = network_->publish_alert(*decision.alert); !sent)
      surroundings_.log(
          4, message_ids::bus_failed,
          pair.config->name + ": " + sent.error().context + "; the alert is kept and sent at the next start");
  for (const JournalEntry& entry : decision.journal)
    surroundings_.log(entry.priority, entry.message_id, {entry.text, entry.fields});
}

/// Makes a decision happen. After a failure each window writes, to see whether that works again.
void Service::apply(Pair& pair, PairDecision decision) {
  const bool may_wait = decision.is_evidence_only() && !pair.store_failure && !ledger_.head_failure();
  if (decision.state && (may_wait ? take_evidence(pair, decision) : commit(pair, decision))) {
    publish(pair, decision);
    const bool extrinsic_changed = decision.record && decision.record->decision != Decision::baseline &&
                                   decision.record->decision != Decision::rejected;
    if (extrinsic_changed) publish_extrinsics();
  }
  collect_status();
}

Result<Answer> Service::apply_request(Pair& pair, PairDecision decision) {
  const bool changes = decision.state.has_value();
  Result<Answer> answer = std::move(decision.answer);
  apply(pair, std::move(decision));
  if (changes && answer && pair.store_failure)
    return fail(ErrorCode::failed, "the record could not be written; see the journal");
  return answer;
}

void Service::conclude(std::size_t index, Measurement measurement) {
  Pair& pair = *pairs_[index];
  PairDecision decision = pair.pipeline.decide(pair.state, std::move(measurement), now(pair));
  const bool due = decision.recalibration_due;
  apply(pair, std::move(decision));
  if (!due || pair.store_failure || ledger_.signing_refused()) return;
  [[maybe_unused]] const auto answer = recalibrate(index, "calibd", /*dry_run=*/false);
}

void Service::conclude(std::size_t index, const Skip& skip) {
  Pair& pair = *pairs_[index];
  apply(pair, pair.pipeline.decide(pair.state, skip, now(pair)));
}

Result<void> Service::run(const std::function<void()>& alive) {
  alive_ = alive;
  auto next = steady_clock::now();
  while (!stopping()) {
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      if (!stopping()) sample(i);
      if (const auto& failure = pairs_[i]->store_failure; failure && failure->code == ErrorCode::store_moved)
        return tl::unexpected(*failure);
      answer_requests();
      alive_();
    }
    next = std::max(next + config_.sampling.period, steady_clock::now());
    while (steady_clock::now() < next && !stopping()) {
      {
        std::unique_lock lock(mutex_);
        wake_.wait_until(lock, std::min(next, steady_clock::now() + 1s),
                         [&] { return stopping_ || !requests_.empty(); });
      }
      answer_requests();
      next = std::min(next, steady_clock::now() + config_.sampling.period);  // it may be shorter since a reload
      save_evidence_when_due();
      alive_();
    }
  }
  answer_requests();  // that calibd ends
  save_evidence();
  return {};
}

void Service::stop() {
  const std::lock_guard lock(mutex_);
  stopping_ = true;
  wake_.notify_all();
  network_->interrupt();
}

bool Service::stopping() const {
  const std::lock_guard lock(mutex_);
  return stopping_;
}

/// In the middle of a long step: writes what must not wait for its end, feeds the watchdog, and says whether to go on.
bool Service::keep_going() {
  if (const auto time = surroundings_.clock().since_boot; time >= last_alive_ + 200ms) {
    last_alive_ = time;
    if (stopping())
      save_evidence();
    else
      save_evidence_when_due();
    answer_acknowledgements();
    alive_();
  }
  return !stopping();
}

ControlReply Service::answer(const PendingRequest& pending) {
  return std::visit([&](const auto& request) { return answer(request, pending); }, pending.request);
}

void Service::ask(PendingRequest request) {
  if (waits_for_event(request)) return;
  if (only_shows(request.request)) return request.reply(answer(request));
  std::unique_lock lock(mutex_);
  if (requests_.size() >= most_requests)
    std::erase_if(requests_, [](const PendingRequest& waiting) { return waiting.client_gone->load(); });
  if (requests_.size() >= most_requests) {
    lock.unlock();
    return request.reply(Error{ErrorCode::failed, "too many requests wait; ask later"});
  }
  requests_.push_back(std::move(request));
  wake_.notify_all();
}

/// Between two pairs, when nothing is being measured.
void Service::answer_requests() {
  std::deque<PendingRequest> requests;
  {
    const std::lock_guard lock(mutex_);
    requests.swap(requests_);
  }
  for (const PendingRequest& request : requests)
    request.reply(stopping() ? ControlReply(Error{ErrorCode::failed, "calibd ends"}) : answer(request));
}

Result<std::size_t> Service::find(const std::string& name) const {
  const auto found = std::ranges::find_if(pairs_, [&](const auto& pair) { return pair->config->name == name; });
  if (found == pairs_.end()) return fail(ErrorCode::not_found, "there is no pair '" + escape_control(name) + "'");
  return static_cast<std::size_t>(found - pairs_.begin());
}

ControlReply Service::answer(const StatusRequest&, const PendingRequest&) { return status(); }

ControlReply Service::answer(const RecordsRequest& request, const PendingRequest&) {
  auto page = records(request.from);
  return page ? ControlReply(std::move(*page)) : ControlReply(page.error());
}

}  // namespace calib
