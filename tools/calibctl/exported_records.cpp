#include "exported_records.hpp"

#include <algorithm>

#include "calib/file.hpp"

namespace calib::ctl {
namespace {

struct Exported {
  std::filesystem::path file;
  SignedRecord bytes;
};

Result<std::string> read_text_file(const std::filesystem::path& file) {
  auto text = read_regular_file(file, largest_export);
  if (text) return text;
  return fail(text.error().code == ErrorCode::file_too_large ? ErrorCode::malformed_record : ErrorCode::not_found,
              text.error().context);
}

/// The change of keys that `key` has signed, on either side; nothing when this is none.
std::optional<CalibrationRecord> change_with(const PublicKey& key, const SignedRecord& bytes) {
  const auto [first, second] = split_signatures(bytes.signature);
  const bool by_first = verify_signature(bytes.canonical, first, key).has_value();
  if (!by_first && !verify_signature(bytes.canonical, second, key)) return std::nullopt;
  auto record = parse_record(bytes.canonical);
  if (!record || !record->key_change) return std::nullopt;
  const KeyChange& change = *record->key_change;
  const bool by_all = change.previous_lost ? second.empty() && verify_signature(bytes.canonical, first, change.next)
                                           : verify_signature(bytes.canonical, first, change.previous) &&
                                                 verify_signature(bytes.canonical, second, change.next);
  // A lost key is believed to be lost by who trusts the next one.
  const bool believed = change.next == key || (change.previous == key && !change.previous_lost);
  return by_all && believed ? std::optional(std::move(*record)) : std::nullopt;
}

/// All keys that lead from the trusted one, with the records that they may sign.
std::vector<KeyPeriod> known_keys(const std::vector<Exported>& exported, const PublicKey& trusted) {
  std::vector<KeyPeriod> known{{.key = trusted}};
  for (std::size_t i = 0; i < known.size(); ++i)
    for (const Exported& each : exported) {
      const auto record = change_with(known[i].key, each.bytes);
      if (!record) continue;
      const KeyChange& change = *record->key_change;
      const bool is_end = change.previous == known[i].key;
      (is_end ? known[i].until.emplace(record->sequence) : known[i].from = record->sequence + 1);
      const PublicKey& other = is_end ? change.next : change.previous;
      if (std::ranges::find(known, other, &KeyPeriod::key) != known.end()) continue;
      if (is_end)
        known.push_back({.key = other, .from = record->sequence + 1});
      else
        known.push_back({.key = other, .from = 1, .until = record->sequence});
    }
  return known;
}

Result<CalibrationRecord> verify(const Exported& exported, const std::vector<KeyPeriod>& known) {
  const SignedRecord& bytes = exported.bytes;
  for (const KeyPeriod& period : known) {
    if (auto change = change_with(period.key, bytes)) return *std::move(change);
    if (!verify_signature(bytes.canonical, bytes.signature, period.key)) continue;
    auto record = parse_record(bytes.canonical);
    if (!record) return record;
    if (record->key_change)
      return fail(ErrorCode::wrong_key,
                  "it is a change of keys that key " + period.key.id_text() + " cannot make alone");
    if (!period.holds(record->sequence))
      return fail(ErrorCode::wrong_key, "it is signed with key " + period.key.id_text() +
                                            ", which is not the one that is valid for record " +
                                            std::to_string(record->sequence));
    return record;
  }
  return verify_signature(bytes.canonical, bytes.signature, known.front().key).and_then([&] {
    return parse_record(bytes.canonical);
  });
}

}  // namespace

Result<std::vector<Chain::Link>> read_exported(const std::vector<std::filesystem::path>& files,
                                               const PublicKey& trusted) {
  std::vector<Exported> exported;
  for (const auto& file : files) {
    if (file.extension() == ".minisig") continue;
    auto canonical = read_text_file(file);
    if (!canonical) return propagate(canonical);
    auto signature = read_text_file(file.string() + ".minisig");
    if (!signature) return propagate(signature);
    exported.push_back({file, {std::move(*canonical), std::move(*signature)}});
  }
  const auto known = known_keys(exported, trusted);
  std::vector<Chain::Link> records;
  for (Exported& each : exported) {
    auto record = verify(each, known);
    if (!record) return fail(record.error().code, each.file.string() + " does not verify: " + record.error().context);
    records.push_back({std::move(*record), std::move(each.bytes)});
  }
  return records;
}

}  // namespace calib::ctl
