#include <algorithm>

#include "ledger.hpp"

namespace calib {
namespace {

/// Whether a record replaces a key that is lost, and the next one has signed it.
bool says_lost(const Result<SignedRecord>& record) {
  const auto parsed = record.and_then([](const SignedRecord& bytes) { return parse_record(bytes.canonical); });
  return parsed && parsed->key_change && parsed->key_change->previous_lost &&
         verify_signature(record->canonical, record->signature, parsed->key_change->next);
}

}  // namespace

/// Verifies all records, and finds out whether this key may sign the next one.
Result<std::vector<CalibrationRecord>> Ledger::read_records(const std::optional<PublicKey>& trusted) {
  const auto count = store_.record_count();
  if (!count) return propagate(count);
  std::vector<CalibrationRecord> records;
  const auto read = [&](const PublicKey& key) {
    records.clear();
    return visit_verified(
        *count, [this](std::uint64_t sequence) { return store_.record(sequence); }, key,
        [&](const CalibrationRecord& record, const SignedRecord&) { records.push_back(record); });
  };
  const PublicKey own = key_.public_key();
  const auto by_own = read(own);
  if (by_own) {
    periods_ = *by_own;
    if (periods_.back().key == own) return records;
    signing_refused_ = "key " + own.id_text() + " is not the chain's key " + periods_.back().key.id_text() +
                       ", which replaced it in record " + std::to_string(periods_.back().from - 1) +
                       "; put the secret key of that one in place, and restart calibd";
    return records;
  }
  // Where this key has signed some records and not those after them, somebody has changed the store; or has replaced
  // this key, which was lost and is back.
  const bool is_other_key = records.empty() || says_lost(store_.record(records.size() + 1));
  if (by_own.error().code != ErrorCode::wrong_key || !is_other_key) return propagate(by_own);
  const auto by_trusted = trusted ? read(*trusted) : fail(ErrorCode::key_not_found, "there is no public key beside it");
  if (by_trusted) {
    periods_ = *by_trusted;
    signing_refused_ = "key " + own.id_text() + " is not the chain's key " + periods_.back().key.id_text() +
                       "; put the secret key of that one in place and restart calibd, or, if it is lost, run: calibctl "
                       "rotate-key --lost";
    return records;
  }
  records.clear();  // those of a chain that goes on with what cannot be believed may be outdated
  signing_refused_ = "the records in " + state_dir_.string() + " do not verify with key " + own.id_text() + " (" +
                     by_own.error().context + "), nor with the public key that is trusted (" +
                     by_trusted.error().context + "); put their key in place, or move that folder and " +
                     head_dir_.string() + " away, and restart calibd";
  return records;
}

/// Alerts on DDS need no signature, and are worth the most when something is wrong. The fleet is told nothing that it
/// could not verify.
Result<Ledger::Written> Ledger::write_unsigned(std::string_view pair, Entry entry, const Moment& now) {
  Written written{std::move(entry.record), std::move(entry.alert)};
  if (written.record && written.record->decision != Decision::initial)
    return fail(ErrorCode::wrong_key, *signing_refused_);
  const auto done = store_.in_transaction([&]() -> Result<void> {
    if (!written.alert) return {};
    const auto next = store_.next_alert_sequence();
    if (!next) return propagate(next);
    written.alert->alert_sequence = *next;
    return store_.keep_alert(alert_text(*written.alert)).map([](std::uint64_t) {});
  });
  if (!done) return propagate(done);
  if (written.record) {
    complete(*written.record, pair, now);
    written.record->sequence = 0;
    histories_[written.record->pair].add(*written.record);
  }
  return written;
}

/// The record of a change that is allowed, less what all records have in common.
Result<CalibrationRecord> Ledger::key_change(const NewKey& request) const {
  const bool lost = !request.key;
  const PublicKey own = key_.public_key();
  if (lost && !signing_refused_)
    return fail(ErrorCode::bad_request, "key " + own.id_text() + " is the chain's key and is there; nothing is lost");
  if (!lost && signing_refused_) return fail(ErrorCode::wrong_key, *signing_refused_);
  if (periods_.empty())
    return fail(ErrorCode::wrong_key, "which key is lost cannot be told: " + signing_refused_.value_or(""));
  const PublicKey next = lost ? own : request.key->public_key();
  if (std::ranges::any_of(periods_, [&](const KeyPeriod& period) { return period.key == next; }))
    return fail(ErrorCode::bad_request, "key " + next.id_text() +
                                            " has signed records of this chain before, and does not come back; make a "
                                            "new one with `calibctl keygen`");
  const KeyPeriod& last = periods_.back();
  if (request.doubted_from && (*request.doubted_from < last.from || *request.doubted_from > last_sequence_))
    return fail(ErrorCode::bad_request, "key " + last.key.id_text() + " has signed records " +
                                            std::to_string(last.from) + " to " + std::to_string(last_sequence_) +
                                            "; one of these is the first that may be doubted");
  CalibrationRecord record;
  record.decision = Decision::key_changed;
  record.asked_by = request.asked_by;
  record.comment = request.comment;
  record.reason = "key " + next.id_text() + " replaces key " + last.key.id_text() + (lost ? ", which is lost" : "");
  if (request.doubted_from)
    record.reason +=
        "; its records from " + std::to_string(*request.doubted_from) + " on may be of somebody else who had it";
  record.key_change = KeyChange{last.key, next, lost, request.doubted_from};
  return record;
}

Result<CalibrationRecord> Ledger::change_key(NewKey request, const std::map<std::string_view, const PairState*>& states,
                                             const Moment& now) {
  auto record = key_change(request);
  if (!record) return record;
  if (!request.key) {
    // Nobody can authenticate the head any more; what it says is better than nothing.
    if (const auto head = read_chain_head(head_dir_, nullptr); head && *head) head_.missing = missing_from(**head);
    records_missing_ = head_.missing;
  } else if (auto prepared = write_chain_head(head_dir_, head_, key_, &*request.key); !prepared) {
    return propagate(prepared);  // a crash between record and head would look like missing records
  }
  const SigningKey& next = request.key ? *request.key : key_;
  complete(*record, "", now);
  const auto signed_record = sign_key_change(*record, request.key ? &key_ : nullptr, next);
  if (!signed_record) return propagate(signed_record);
  const std::string sha256 = sha256_hex(signed_record->canonical);
  Feed feed = feed_;
  const Feed::Writer writer{store_, next, provenance_.vehicle, now.wall};
  const auto done = store_.in_transaction([&]() -> Result<void> {
    auto appended = store_.append_record(record->sequence, "", *signed_record);
    // What was told is authenticated, too: only with the key itself it can be carried over.
    if (appended && !request.key) appended = feed.restore(writer);
    if (appended) appended = feed.tell(writer, *record, *signed_record);
    for (auto state = states.begin(); appended && state != states.end(); ++state)
      appended =
          store_.save_state(state->first, authenticated(next, state->first, record->sequence, sha256, *state->second));
    return appended;
  });
  if (!done) return propagate(done);

  feed_ = std::move(feed);
  count_waiting_events();
  periods_.back().until = record->sequence;
  periods_.back().doubted_from = request.doubted_from;
  periods_.push_back({.key = next.public_key(), .from = record->sequence + 1});
  last_sequence_ = record->sequence;
  last_sha256_ = sha256;
  head_.missing.reset();
  signing_refused_.reset();
  if (request.key) key_ = std::move(*request.key);
  write_head();
  // Evidence follows the states that were just written; a file that only the other key can read would be an error.
  evidence_ = {.number = evidence_.number + 1};
  if (const auto written = calib::write_evidence(state_dir_, evidence_, key_); !written)
    evidence_failure_ = written.error();
  doubt_records();
  return record;
}

void Ledger::doubt_records() {
  for (const KeyPeriod& period : periods_)
    if (period.doubted_from)
      for (auto& [pair, history] : histories_) history.doubt(*period.doubted_from, *period.until);
}

}  // namespace calib
