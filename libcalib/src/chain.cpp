#include "calib/chain.hpp"

#include <algorithm>

namespace calib {
namespace {

/// In every change of keys, and hardly anywhere else: what does not have it need not be verified to be passed over.
constexpr std::string_view mark = R"("decision":"key_changed")";

/// The change of keys that `next` has signed, if this is one.
std::optional<KeyChange> change_to(const PublicKey& next, const SignedRecord& record) {
  if (record.canonical.find(mark) == std::string::npos) return std::nullopt;
  const auto [first, second] = split_signatures(record.signature);
  if (!verify_signature(record.canonical, second.empty() ? first : second, next)) return std::nullopt;
  const auto parsed = parse_record(record.canonical);
  if (!parsed || !parsed->key_change || parsed->key_change->next != next) return std::nullopt;
  return parsed->key_change;
}

std::string record_number(std::uint64_t sequence) { return "record " + std::to_string(sequence); }

}  // namespace

const KeyPeriod& period_of(std::uint64_t sequence, const std::vector<KeyPeriod>& periods) {
  const auto found = std::ranges::find_if(periods, [&](const KeyPeriod& period) { return period.holds(sequence); });
  return found == periods.end() ? periods.back() : *found;
}

Signatures split_signatures(std::string_view text) {
  std::size_t end = 0;
  for (int line = 0; line < 4 && end < text.size(); ++line) end = std::min(text.find('\n', end), text.size() - 1) + 1;
  return {text.substr(0, end), text.substr(end)};
}

Anchor find_anchor(std::uint64_t count, const RecordOf& record_of, const PublicKey& trusted) {
  Anchor anchor{.first = trusted};
  for (std::uint64_t sequence = count; sequence > 0; --sequence) {
    const auto record = record_of(sequence);
    if (!record) continue;
    if (const auto change = change_to(anchor.first, *record)) {
      anchor.vouched.emplace(sequence, *change);
      anchor.first = change->previous;
    }
  }
  return anchor;
}

Result<CalibrationRecord> ChainVerifier::next(const SignedRecord& record) {
  auto verified = verify(record);
  if (!verified) return tl::unexpected(explained(record, std::move(verified.error())));
  ++last_sequence_;
  last_sha256_ = sha256_hex(record.canonical);
  if (const auto& change = verified->key_change) {
    periods_.back().until = last_sequence_;
    periods_.back().doubted_from = change->doubted_from;
    periods_.push_back({.key = change->next, .from = last_sequence_ + 1});
  }
  return verified;
}

Result<CalibrationRecord> ChainVerifier::verify(const SignedRecord& record) const {
  const PublicKey& valid = periods_.back().key;
  const std::uint64_t sequence = last_sequence_ + 1;
  const auto [first, second] = split_signatures(record.signature);
  const auto vouched = vouched_.find(sequence);
  const bool lost = vouched != vouched_.end() && vouched->second.previous_lost;
  if (second.empty() && !lost) return verify_record(record, valid, last_sha256_, sequence);

  if (const auto is_signed = verify_signature(record.canonical, first, lost ? vouched->second.next : valid); !is_signed)
    return propagate(is_signed);
  auto parsed = parse_link(record.canonical, last_sha256_, sequence);
  if (!parsed) return parsed;
  if (!parsed->key_change || parsed->key_change->previous_lost != lost || second.empty() != lost)
    return fail(ErrorCode::broken_chain, "it has other signatures than what it says needs");
  if (auto allowed = may_change(*parsed->key_change); !allowed) return propagate(allowed);
  if (lost) return parsed;
  const auto by_next = verify_signature(record.canonical, second, parsed->key_change->next);
  if (!by_next)
    return fail(by_next.error().code, "it names another key, which has not signed it: " + by_next.error().context);
  return parsed;
}

Result<void> ChainVerifier::may_change(const KeyChange& change) const {
  const KeyPeriod& period = periods_.back();
  if (change.previous != period.key)
    return fail(ErrorCode::broken_chain,
                "it replaces key " + change.previous.id_text() + ", but the valid one is " + period.key.id_text());
  const auto is_next = [&](const KeyPeriod& earlier) { return earlier.key == change.next; };
  if (std::ranges::any_of(periods_, is_next))
    return fail(ErrorCode::broken_chain, "it names key " + change.next.id_text() + ", which was replaced before");
  if (change.doubted_from && (*change.doubted_from < period.from || *change.doubted_from > last_sequence_ + 1))
    return fail(ErrorCode::broken_chain, "it doubts records that the key before it has not signed");
  return {};
}

/// Says more where a key has signed that was valid once, or one that has yet to be believed.
Error ChainVerifier::explained(const SignedRecord& record, Error error) const {
  if (error.code != ErrorCode::wrong_key) return error;
  const auto first = split_signatures(record.signature).first;
  for (const KeyPeriod& period : periods_)
    if (period.until && verify_signature(record.canonical, first, period.key))
      return {error.code, "it is signed with key " + period.key.id_text() + ", which " + record_number(*period.until) +
                              " has replaced with key " + periods_.back().key.id_text()};
  const auto parsed = record.canonical.find(mark) == std::string::npos ? fail(ErrorCode::wrong_key, "")
                                                                       : parse_record(record.canonical);
  if (parsed && parsed->key_change && parsed->key_change->previous_lost &&
      verify_signature(record.canonical, record.signature, parsed->key_change->next))
    error.context = "it says that key " + periods_.back().key.id_text() + " was lost, and is signed with key " +
                    parsed->key_change->next.id_text() +
                    " alone: who believes that gives that one's public key as the trusted one";
  return error;
}

Result<std::vector<KeyPeriod>> visit_verified(
    std::uint64_t count, const RecordOf& record_of, const PublicKey& trusted,
    const std::function<void(const CalibrationRecord&, const SignedRecord&)>& visit) {
  ChainVerifier verifier(find_anchor(count, record_of, trusted));
  for (std::uint64_t sequence = 1; sequence <= count; ++sequence) {
    const auto stored = record_of(sequence);
    const auto record = stored.and_then([&](const SignedRecord& bytes) { return verifier.next(bytes); });
    if (!record) {
      const Error& error = record.error();
      // A gap is a chain that somebody has broken, not a record that was asked for in vain.
      return fail(error.code == ErrorCode::record_not_found ? ErrorCode::broken_chain : error.code,
                  record_number(sequence) + " does not verify: " + error.context);
    }
    visit(*record, *stored);
  }
  return verifier.periods();
}

}  // namespace calib
