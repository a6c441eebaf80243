#include "stored_records.hpp"

#include <unistd.h>

#include <cerrno>
#include <nlohmann/json.hpp>

#include "calib/file.hpp"
#include "calib/json_integer.hpp"
#include "control_client.hpp"

namespace calib::ctl {
namespace {

using nlohmann::json;

constexpr std::chrono::seconds timeout{10};

Result<std::vector<SignedRecord>> from_store(const Paths& paths) {
  const auto store = Store::open(paths.store(), Store::Mode::read_only);
  if (!store) return propagate(store);
  const auto count = store->record_count();
  if (!count) return propagate(count);
  std::vector<SignedRecord> records;
  for (std::uint64_t sequence = 1; sequence <= *count; ++sequence) {
    auto record = store->record(sequence);
    if (!record && record.error().code != ErrorCode::record_not_found) return propagate(record);
    records.push_back(record ? std::move(*record) : SignedRecord{});  // a missing record does not verify
  }
  return records;
}

Result<std::vector<SignedRecord>> from_daemon(const Paths& paths) {
  std::vector<SignedRecord> records;
  for (;;) {
    const auto reply =
        ask(paths.socket, {{"schema", 1}, {"request", "records"}, {"from", records.size() + 1}}, timeout, [](auto) {});
    if (!reply)
      return fail(reply.error().code,
                  "only calibd and root may read " + paths.store().string() + ", and " + reply.error().context);
    try {
      const std::size_t before = records.size();
      for (const json& record : reply->at("records").get_ref<const json::array_t&>())
        records.push_back({record.at("canonical").get<std::string>(), record.at("signature").get<std::string>()});
      if (records.size() >= integer_from<std::uint64_t>(reply->at("stored"))) return records;
      if (records.size() == before) return fail(ErrorCode::malformed_reply, "calibd has more records than it shows");
    } catch (const std::exception& error) {
      return fail(ErrorCode::malformed_reply,
                  std::string("calibd answered in a form that is not understood: ") + error.what());
    }
  }
}

/// Number of the last record as calibd noted it outside the store; nothing if that cannot be read.
std::optional<std::uint64_t> noted_head(const Paths& paths) {
  const auto text = read_regular_file(paths.chain_head(), 64 * 1024);
  if (!text) return std::nullopt;
  const json head = json::parse(*text, nullptr, /*allow_exceptions=*/false);
  if (!head.is_object() || !head.contains("sequence") || !head["sequence"].is_number_unsigned()) return std::nullopt;
  return head["sequence"].get<std::uint64_t>();
}

std::string numbers(std::uint64_t from, std::uint64_t to) {
  return from == to ? "record " + std::to_string(from)
                    : "records " + std::to_string(from) + " to " + std::to_string(to);
}

}  // namespace

bool only_daemon_may_read(const Paths& paths) { return ::access(paths.store().c_str(), R_OK) != 0 && errno == EACCES; }

std::string Chain::key_id(std::uint64_t sequence) const {
  // Where the chain breaks later, the verified records themselves say which key follows.
  PublicKey valid = periods.empty() ? key : periods.front().key;
  for (const Link& link : verified) {
    const auto& change = link.record.key_change;
    if (!change) continue;
    if (link.record.sequence == sequence && change->previous_lost) return change->next.id_text();
    if (link.record.sequence >= sequence) return change->previous.id_text();
    valid = change->next;
  }
  return valid.id_text();
}

std::string Chain::keys() const {
  if (periods.size() < 2) return "key " + (periods.empty() ? key : periods.front().key).id_text();
  std::string text = "keys";
  for (const KeyPeriod& period : periods) {
    const std::uint64_t last = period.until.value_or(stored);
    text += (&period == &periods.front() ? " " : ", ") + period.key.id_text();
    text += period.from > last ? " (from the next record on)" : " (" + numbers(period.from, last) + ")";
    if (period.doubted_from)
      text += " REVOKED: " + numbers(*period.doubted_from, *period.until - 1) + " may be of somebody else";
  }
  return text;
}

Result<Chain> read_chain(const Paths& paths) {
  const auto last = noted_head(paths);  // before the store: the chain may grow meanwhile
  const auto stored = only_daemon_may_read(paths) ? from_daemon(paths) : from_store(paths);
  if (!stored) return propagate(stored);
  const auto key = load_public_key(paths.public_key);
  if (!key) return propagate(key);
  Chain chain{.key = *key, .stored = stored->size()};
  const auto record_of = [&](std::uint64_t sequence) -> Result<SignedRecord> {
    const SignedRecord& record = (*stored)[sequence - 1];
    if (record.canonical.empty())
      return fail(ErrorCode::record_not_found, "the store holds no record " + std::to_string(sequence));
    return record;
  };
  const auto all =
      visit_verified(chain.stored, record_of, *key, [&](const CalibrationRecord& record, const SignedRecord& bytes) {
        chain.verified.push_back({record, bytes});
      });
  if (all) chain.periods = *all;
  if (!all)
    chain.broken = all.error();
  else if (last && *last > chain.stored)
    chain.broken = Error{ErrorCode::broken_chain, "the store ends with record " + std::to_string(chain.stored) +
                                                      ", but calibd had written record " + std::to_string(*last) +
                                                      ": records were deleted, or an older store was restored"};
  return chain;
}

}  // namespace calib::ctl
