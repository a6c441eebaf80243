#include <algorithm>
#include <limits>

#include "calib/store.hpp"
#include "service.hpp"

namespace calib {
namespace {

/// Of what a status shows; without a verdict, there is no estimate either.
DriftAlert alert_of(const std::string& vehicle, const PairStatus& pair, WallTime now) {
  DriftAlert alert;
  alert.stamp = now;
  alert.vehicle = vehicle;
  alert.pair = pair.name;
  alert.verdict = pair.verdict;
  alert.reason = pair.reason;
  alert.misalignment.sigma.setConstant(std::numeric_limits<double>::infinity());
  if (pair.misalignment && pair.verdict != Verdict::not_evaluated) {
    alert.misalignment.delta = pair.misalignment->delta;
    alert.misalignment.sigma = pair.misalignment->sigma;
  }
  if (pair.record) alert.record_sequence = pair.record->sequence;
  return alert;
}

/// Whether a state tells something: not that calibd has just started.
bool is_settled(const PairStatus& pair) {
  return pair.cause != ErrorCode::starting && pair.cause != ErrorCode::no_pair_yet;
}

}  // namespace

/// What the fleet is told without a decision; nothing while there is no key that it could be verified with. Where the
/// store cannot be written, it is tried again the next time.
void Service::tell_fleet(const Status& status) {
  if (ledger_.signing_refused()) return;
  using Told = std::function<Result<void>(Feed&, const Feed::Writer&)>;
  const Moment time = surroundings_.clock();
  const auto tell = [&](const Told& what) { return ledger_.tell(what, time).has_value(); };
  if (ledger_.feed().held_is_due(time.wall))
    tell([](Feed& feed, const auto& writer) { return feed.tell_held(writer); });

  for (const PairStatus& pair : status.pairs) {
    if (pair.verdict != Verdict::not_evaluated) {
      without_verdict_since_.erase(pair.name);
      // What was found while nothing could be signed is told now.
      if (pair.verdict != Verdict::calibrated && ledger_.feed().is_untold(pair.name))
        tell([&](Feed& feed, const auto& writer) {
          return feed.tell(writer, alert_of(config_.vehicle, pair, time.wall));
        });
      continue;
    }
    const auto since = without_verdict_since_.try_emplace(pair.name, time.since_boot).first->second;
    if (ledger_.feed().unavailable_is_due(pair.name, time.since_boot - since))
      tell([&](Feed& feed, const auto& writer) {
        return feed.tell_unavailable(writer, alert_of(config_.vehicle, pair, time.wall));
      });
  }

  const auto failing = std::ranges::find_if(pairs_, [](const auto& pair) { return pair->store_failure.has_value(); });
  if (failing != pairs_.end()) {
    store_trouble_ = (*failing)->store_failure->context;
    return;
  }
  std::string trouble = store_trouble_;
  if (!trouble.empty()) trouble += "; it can be written again";
  if (trouble.empty() && ledger_.records_missing()) trouble = *ledger_.records_missing();
  if (trouble.empty() && ledger_.head_failure()) trouble = ledger_.head_failure()->context;
  if (ledger_.feed().is_news(trouble) &&
      tell([&](Feed& feed, const auto& writer) { return feed.tell_trouble(writer, trouble); }))
    store_trouble_.clear();

  constexpr std::chrono::hours longest_start{1};
  if (ledger_.feed().state_is_due(time.wall) &&
      (std::ranges::all_of(status.pairs, is_settled) || time.since_boot - started_ >= longest_start))
    tell([&](Feed& feed, const auto& writer) { return feed.tell_state(writer, status); });
}

std::string Service::run_id() const { return ledger_.provenance().boot_id + '-' + std::to_string(started_.count()); }

/// By a connection of its own: the ledger's belongs to the other thread.
Result<FeedPage> Service::events(std::uint64_t after, std::size_t limit) const {
  const auto store = Store::open(config_.state_dir / "calibd.db", Store::Mode::read_only);
  if (!store) return fail(ErrorCode::failed, store.error().context);
  const auto waiting = store->waiting_event_count();
  auto events = store->waiting_events(after, limit);
  if (!waiting || !events) return fail(ErrorCode::failed, (waiting ? events.error() : waiting.error()).context);
  // What a store of schema 1 has left is no event before it is signed.
  std::erase_if(*events, [](const Store::Event& event) { return event.priority == Store::Priority::unsent_alert; });
  return FeedPage{config_.vehicle, run_id(), *waiting, std::move(*events)};
}

ControlReply Service::answer(const FeedRequest& request, const PendingRequest&) {
  auto page = events(request.after, request.limit);
  return page ? ControlReply(std::move(*page)) : ControlReply(page.error());
}

ControlReply Service::answer(const AcknowledgeRequest& request, const PendingRequest& pending) {
  if (!pending.peer.may_acknowledge)
    return Error{ErrorCode::denied,
                 "only root, the daemon's user, members of its group and calib-uplink may ask for that"};
  if (request.run != run_id()) return Error{ErrorCode::bad_request, "that event is of another run of calibd"};
  if (const auto done = ledger_.acknowledge(request.through); !done)
    return Error{ErrorCode::failed, done.error().context};
  return Acknowledged{ledger_.waiting_event_count()};
}

/// Keeps a request that asks for an event which is not there yet.
bool Service::waits_for_event(PendingRequest& request) {
  const auto* feed = std::get_if<FeedRequest>(&request.request);
  if (feed == nullptr || !feed->wait) return false;
  const std::lock_guard lock(mutex_);
  std::erase_if(waiting_for_events_, [](const auto& waiting) { return waiting.request.client_gone->load(); });
  if (waiting_for_events_.size() >= most_waiting_for_events) return false;
  // An event that is written from now on is noticed by `collections_`; one that is there already, here.
  if (const auto page = events(feed->after, 1); !page || !page->events.empty()) return false;
  waiting_for_events_.push_back({std::move(request), surroundings_.clock().since_boot});
  return true;
}

void Service::answer_who_waits_for_events() {
  std::vector<WaitsForEvent> waiting;
  std::uint64_t collections = 0;
  {
    const std::lock_guard lock(mutex_);
    waiting.swap(waiting_for_events_);
    collections = collections_;
  }
  const bool news = std::exchange(collection_told_, collections) != collections;
  const auto now = surroundings_.clock().since_boot;
  for (WaitsForEvent& one : waiting) {
    if (one.request.client_gone->load()) continue;
    auto reply = now - one.since >= longest_wait_for_events || news ? answer(one.request) : ControlReply(FeedPage{});
    const auto* page = std::get_if<FeedPage>(&reply);
    if (now - one.since < longest_wait_for_events && page != nullptr && page->events.empty()) {
      const std::lock_guard lock(mutex_);
      waiting_for_events_.push_back(std::move(one));
    } else {
      one.request.reply(std::move(reply));
    }
  }
}

/// Also in the middle of a long step: nothing that is measured depends on the outbox.
void Service::answer_acknowledgements() {
  std::vector<PendingRequest> acknowledgements;
  {
    const std::lock_guard lock(mutex_);
    const auto is_one = [](const PendingRequest& request) {
      return std::holds_alternative<AcknowledgeRequest>(request.request);
    };
    std::ranges::copy_if(requests_, std::back_inserter(acknowledgements), is_one);
    std::erase_if(requests_, is_one);
  }
  for (const PendingRequest& request : acknowledgements) request.reply(answer(request));
}

}  // namespace calib
