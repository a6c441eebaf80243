#include "ledger.hpp"

#include <sys/statvfs.h>

#include <algorithm>
#include <array>
#include <cstdlib>
#include <iterator>
#include <sstream>

namespace calib {
namespace {

/// What a decision may need. Without it evidence has no place to go to, a minute before that would show.
constexpr std::uint64_t least_free_bytes = 32 << 10;
constexpr std::string_view state_purpose = "calibd pair state";

/// The line in front of a state in the store.
std::string mac_of(std::string_view text) { return std::string(text.substr(0, text.find('\n'))); }

}  // namespace

Ledger::Ledger(Store store, std::filesystem::path state_dir, std::filesystem::path head_dir, SigningKey key,
               Provenance provenance, FeedSettings feed)
    : store_(std::move(store)),
      state_dir_(std::move(state_dir)),
      head_dir_(std::move(head_dir)),
      key_(std::move(key)),
      provenance_(std::move(provenance)),
      feed_(feed) {}

Result<Ledger> Ledger::open(const std::filesystem::path& state_dir, const std::filesystem::path& head_dir,
                            SigningKey key, Provenance provenance, FeedSettings feed,
                            const std::optional<PublicKey>& trusted) {
  auto store = Store::open(state_dir / "calibd.db", Store::Mode::read_write);
  if (!store) return propagate(store);
  Ledger ledger(std::move(*store), state_dir, head_dir, std::move(key), std::move(provenance), feed);
  auto history = ledger.read_records(trusted);
  if (!history) return propagate(history);
  for (CalibrationRecord& record : *history) {
    if (record.vehicle != ledger.provenance_.vehicle)
      return fail(ErrorCode::other_vehicle,
                  "the records in " + state_dir.string() + " are of vehicle '" + record.vehicle +
                      "', the configuration is of '" + ledger.provenance_.vehicle +
                      "'; correct `vehicle`, or move that folder and " + head_dir.string() + " away");
    ledger.last_sequence_ = record.sequence;
    ledger.written_by_first_version_ = record.evidence_sha256.empty();
    ledger.index(std::move(record));
  }
  if (ledger.last_sequence_ > 0) {
    auto sha256 = ledger.sha256_of(ledger.last_sequence_);
    if (!sha256) return propagate(sha256);
    ledger.last_sha256_ = std::move(*sha256);
  }
  ledger.doubt_records();
  ledger.count_waiting_events();
  // What is authenticated with the key of the chain says nothing to another key, and stays for that one.
  if (ledger.signing_refused_) return ledger;
  if (auto compared = ledger.compare_with_head(); !compared) return propagate(compared);
  const auto restore = [](Feed& told, const Feed::Writer& writer) { return told.restore(writer); };
  if (auto restored = ledger.tell(restore, system_clock()); !restored) return propagate(restored);
  auto evidence = read_evidence(state_dir, ledger.key_);
  if (evidence)
    ledger.evidence_ = std::move(*evidence);
  else
    ledger.evidence_failure_ = std::move(evidence.error());
  return ledger;
}

Result<std::string> Ledger::sha256_of(std::uint64_t sequence) const {
  return store_.record(sequence).map([](const SignedRecord& record) { return sha256_hex(record.canonical); });
}

/// What is not there any more of a chain that had this head.
std::optional<std::string> Ledger::missing_from(const ChainHead& remembered) const {
  if (remembered.sequence > last_sequence_)
    return "records " + std::to_string(last_sequence_ + 1) + " to " + std::to_string(remembered.sequence) +
           ", which calibd had written, are missing";
  if (remembered.sequence > 0 && sha256_of(remembered.sequence) != remembered.sha256)
    return "record " + std::to_string(remembered.sequence) + " is another than the one that calibd had written";
  return std::nullopt;
}

/// Notices records that were cut off, or a store that was put back. calibd goes on with what there is, and says so.
Result<void> Ledger::compare_with_head() {
  const auto remembered = read_chain_head(head_dir_, &key_);
  std::optional<std::string> missing;
  if (!remembered) {
    missing = "whether records are missing cannot be told: " + remembered.error().context;
  } else if (*remembered) {
    head_ = **remembered;
    const auto sha256 = sha256_of(head_.sequence);
    if (!sha256 && sha256.error().code != ErrorCode::record_not_found) return propagate(sha256);
    missing = missing_from(head_);
  } else if (last_sequence_ > 0 && !written_by_first_version_) {
    missing = "whether records are missing cannot be told: " + head_dir_.string() + " does not say how many there were";
  }
  if (missing) head_.missing = missing;
  records_missing_ = head_.missing;
  write_head();
  return {};
}

/// Not part of the records' transaction: it may lag behind them, and never runs ahead.
void Ledger::write_head() {
  head_.sequence = last_sequence_;
  head_.sha256 = last_sha256_;
  const auto written = write_chain_head(head_dir_, head_, key_);
  head_failure_ = written ? std::nullopt : std::optional(written.error());
}

void Ledger::index(CalibrationRecord record) {
  if (record.key_change) return;
  last_of_pair_[record.pair] = record.sequence;
  PairHistory& history = histories_[record.pair];
  if (record.decision == Decision::initial) history.forget_unsigned();
  history.add(std::move(record));
}

const PairHistory& Ledger::history(std::string_view pair) const {
  static const PairHistory none;
  const auto found = histories_.find(pair);
  return found == histories_.end() ? none : found->second;
}

Result<CalibrationRecord> Ledger::find(std::string_view pair, std::uint64_t sequence) const {
  const auto not_of_pair = [&] {
    return fail(ErrorCode::record_not_found,
                "record " + std::to_string(sequence) + " is not of pair " + std::string(pair));
  };
  const auto signed_record = store_.record(sequence);
  if (!signed_record) return propagate(signed_record);
  if (periods_.empty()) return fail(ErrorCode::wrong_key, *signing_refused_);
  const KeyPeriod& period = period_of(sequence, periods_);
  if (period.until == sequence) return not_of_pair();  // a change of keys
  std::string previous_sha256{no_previous_sha256};
  if (sequence > 1) {
    const auto previous = store_.record(sequence - 1);
    if (!previous) return propagate(previous);
    previous_sha256 = sha256_hex(previous->canonical);
  }
  auto record = verify_record(*signed_record, period.key, previous_sha256, sequence);
  if (record && record->pair != pair) return not_of_pair();
  return record;
}

/// Fills in what all records have in common.
void Ledger::complete(CalibrationRecord& record, std::string_view pair, const Moment& now) const {
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
  if (head_.missing) record.reason += "; " + *head_.missing;
}

/// Bound to the pair and to the chain as it was: a state of another pair, of another chain, or of one that was longer
/// is worth nothing.
std::string Ledger::authenticated(const SigningKey& key, std::string_view pair, std::uint64_t sequence,
                                  std::string_view sha256, const PairState& state) {
  std::string text(pair);
  text.append("\n").append(std::to_string(sequence)).append("\n").append(sha256).append("\n") += to_text(state);
  return key.mac(state_purpose, text) + '\n' + text;
}

Result<Ledger::Written> Ledger::write(std::string_view pair, const PairState& state, Entry entry, const Moment& now) {
  if (signing_refused_) return write_unsigned(pair, std::move(entry), now);
  Written written{std::move(entry.record), std::move(entry.alert)};
  std::uint64_t sequence = last_sequence_;
  std::string sha256 = last_sha256_;
  Feed feed = feed_;
  const Feed::Writer writer{store_, key_, provenance_.vehicle, now.wall};
  const auto done = store_.in_transaction([&]() -> Result<void> {
    if (written.record) {
      complete(*written.record, pair, now);
      const auto signed_record = sign_record(*written.record, key_);
      if (!signed_record) return propagate(signed_record);
      // What is written is what is in force: the record becomes, to the last bit, what it will be after a restart.
      auto as_written = parse_record(signed_record->canonical);
      if (!as_written) return propagate(as_written);
      written.record = std::move(*as_written);
      sequence = written.record->sequence;
      sha256 = sha256_hex(signed_record->canonical);
      if (auto appended = store_.append_record(sequence, pair, *signed_record); !appended) return appended;
      if (auto told = feed.tell(writer, *written.record, *signed_record); !told) return told;
    }
    if (written.alert) {
      const auto next = store_.next_alert_sequence();
      if (!next) return propagate(next);
      written.alert->alert_sequence = *next;
      if (auto kept = store_.keep_alert(alert_text(*written.alert)); !kept) return propagate(kept);
      if (auto told = feed.tell(writer, *written.alert); !told) return told;
    }
    return store_.save_state(pair, authenticated(key_, pair, sequence, sha256, state));
  });
  if (!done) return propagate(done);
  if (written.record || written.alert) {
    feed_ = std::move(feed);
    count_waiting_events();
  }
  if (written.record) {
    last_sequence_ = sequence;
    last_sha256_ = sha256;
    head_.missing.reset();
    index(*written.record);
  }
  if (written.record || head_failure_) write_head();
  return written;
}

Result<void> Ledger::is_writable() {
  struct statvfs about {};
  if (::statvfs(state_dir_.c_str(), &about) == 0) {
    if ((about.f_flag & ST_RDONLY) != 0)
      return fail(ErrorCode::store_failed, "the file system of " + state_dir_.string() + " is read-only");
    const auto free_bytes = std::uint64_t{about.f_bavail} * about.f_frsize;
    if (free_bytes < least_free_bytes)
      return fail(ErrorCode::store_failed, "the disk of " + state_dir_.string() +
                                               " is full: " + std::to_string(free_bytes >> 10) + " KiB are free");
  }
  return store_.in_transaction([] { return Result<void>{}; });
}

Result<void> Ledger::write_evidence(const std::map<std::string_view, const PairState*>& states) {
  // In a folder that was moved away, nobody would find it.
  if (auto writable = is_writable(); !writable) return writable;
  if (signing_refused_) return {};  // nobody could read it
  Evidence evidence{.number = evidence_.number + 1};
  for (const auto& [pair, state] : states) {
    const auto stored = store_.state(pair);
    if (!stored) return propagate(stored);
    if (*stored) evidence.pairs[std::string(pair)] = {mac_of(**stored), to_text(*state)};
  }
  auto written = calib::write_evidence(state_dir_, evidence, key_);
  if (written) evidence_.number = evidence.number;
  return written;
}

Result<std::optional<PairState>> Ledger::state(std::string_view pair) const {
  const auto stored = store_.state(pair);
  if (!stored) return propagate(stored);
  if (!*stored) return std::optional<PairState>{};
  const auto refuse = [](const char* why) {
    return fail(ErrorCode::malformed_state, std::string("the saved state ") + why);
  };
  const std::string_view text = **stored;
  const auto end = text.find('\n');
  if (text.starts_with('{')) return refuse("is of an earlier version of calibd");
  if (end == std::string_view::npos || !key_.is_mac(state_purpose, text.substr(end + 1), text.substr(0, end)))
    return refuse("was not written by calibd with this signing key");
  // From here on it is what this program wrote.
  std::array<std::string, 3> head;
  std::istringstream rest{std::string(text.substr(end + 1))};
  for (std::string& line : head) std::getline(rest, line);
  const std::string body(std::istreambuf_iterator<char>(rest), {});
  const std::uint64_t sequence = std::strtoull(head[1].c_str(), nullptr, 10);
  if (head[0] != pair) return refuse("is of another pair");
  const auto last = last_of_pair_.find(pair);
  if (sequence > last_sequence_ || (last != last_of_pair_.end() && last->second > sequence))
    return refuse("is of another time than the records");
  const auto sha256 = sequence == 0 ? Result<std::string>(no_previous_sha256) : sha256_of(sequence);
  if (!sha256) return propagate(sha256);
  if (*sha256 != head[2]) return refuse("is of another chain of records");
  const auto since = evidence_.pairs.find(pair);
  const bool is_newest = since == evidence_.pairs.end() || since->second.follows != mac_of(text);
  auto state = parse_pair_state(is_newest ? body : since->second.state);
  if (!state) return propagate(state);
  return std::optional<PairState>(std::move(*state));
}

Result<Ledger::Alerts> Ledger::latest_alerts(std::size_t limit) const {
  const auto latest = store_.latest_alerts(limit);
  if (!latest) return propagate(latest);
  Alerts read;
  for (const Store::Alert& one : *latest)
    if (auto alert = parse_alert(one.json))
      read.alerts.push_back(std::move(*alert));
    else
      read.unreadable.push_back(
          {alert.error().code, "alert " + std::to_string(one.sequence) + ": " + alert.error().context});
  return read;
}

Result<void> Ledger::tell(const std::function<Result<void>(Feed&, const Feed::Writer&)>& what, const Moment& now) {
  if (signing_refused_) return fail(ErrorCode::wrong_key, *signing_refused_);
  Feed feed = feed_;
  const auto done = store_.in_transaction([&] { return what(feed, {store_, key_, provenance_.vehicle, now.wall}); });
  if (!done) return done;
  feed_ = std::move(feed);
  count_waiting_events();
  return {};
}

Result<void> Ledger::acknowledge(std::uint64_t sequence) {
  const auto done = store_.in_transaction([&] { return store_.acknowledge(sequence); });
  if (done) count_waiting_events();
  return done;
}

void Ledger::count_waiting_events() { waiting_events_ = store_.waiting_event_count().value_or(waiting_events_); }

}  // namespace calib
