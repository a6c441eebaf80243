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

constexpr std::chrono::seconds patience{10};

Result<std::vector<SignedRecord>> from_store(const Places& places) {
  const auto store = Store::open(places.store(), Store::Mode::read_only);
  if (!store) return propagate(store);
  const auto count = store->record_count();
  if (!count) return propagate(count);
  std::vector<SignedRecord> records;
  for (std::uint64_t sequence = 1; sequence <= *count; ++sequence) {
    auto record = store->record(sequence);
    if (!record && record.error().code != ErrorCode::record_not_found) return propagate(record);
    records.push_back(record ? std::move(*record) : SignedRecord{});  // a gap does not verify
  }
  return records;
}

Result<std::vector<SignedRecord>> from_daemon(const Places& places) {
  std::vector<SignedRecord> records;
  for (;;) {
    const auto reply = ask(places.socket, {{"schema", 1}, {"request", "records"}, {"from", records.size() + 1}},
                           patience, [](auto) {});
    if (!reply)
      return fail(reply.error().code,
                  "only calibd and root may read " + places.store().string() + ", and " + reply.error().context);
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

/// What calibd remembers as the last record; nothing where that cannot be read.
std::optional<std::uint64_t> remembered(const Places& places) {
  const auto text = read_regular_file(places.chain_head(), 64 * 1024);
  if (!text) return std::nullopt;
  const json head = json::parse(*text, nullptr, /*allow_exceptions=*/false);
  if (!head.is_object() || !head.contains("sequence") || !head["sequence"].is_number_unsigned()) return std::nullopt;
  return head["sequence"].get<std::uint64_t>();
}

}  // namespace

bool only_daemon_may_read(const Places& places) {
  return ::access(places.store().c_str(), R_OK) != 0 && errno == EACCES;
}

Result<Chain> read_chain(const Places& places) {
  const auto last = remembered(places);  // first: the chain may grow while it is read
  const auto stored = only_daemon_may_read(places) ? from_daemon(places) : from_store(places);
  if (!stored) return propagate(stored);
  const auto key = load_public_key(places.public_key);
  if (!key) return propagate(key);
  Chain chain{*key, {}, stored->size(), std::nullopt};
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
  if (!all)
    chain.broken = all.error();
  else if (last && *last > chain.stored)
    chain.broken = Error{ErrorCode::broken_chain, "the store ends with record " + std::to_string(chain.stored) +
                                                      ", but calibd had written record " + std::to_string(*last) +
                                                      ": records were cut off, or an older store was put back"};
  return chain;
}

}  // namespace calib::ctl
