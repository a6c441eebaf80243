#include <chrono>

#include "calib/record.hpp"

namespace calib {
namespace {

/// minisign's own form, with every part from the record, so that signing it twice gives the same file.
std::string trusted_comment(const CalibrationRecord& record) {
  const auto seconds = std::chrono::floor<std::chrono::seconds>(record.wall_time).count();
  return "timestamp:" + std::to_string(seconds) + "\tfile:" + record_file_name(record.sequence) + "\thashed";
}

}  // namespace

Result<SignedRecord> sign_record(const CalibrationRecord& record, const SigningKey& key) {
  std::string canonical = canonical_bytes(record);
  if (const auto readable = parse_record(canonical); !readable) return propagate(readable);
  std::string signature = key.sign(canonical, trusted_comment(record));
  return SignedRecord{std::move(canonical), std::move(signature)};
}

Result<SignedRecord> sign_key_change(const CalibrationRecord& record, const SigningKey* previous,
                                     const SigningKey& next) {
  auto by_next = sign_record(record, next);
  if (by_next && previous != nullptr)
    by_next->signature.insert(0, previous->sign(by_next->canonical, trusted_comment(record)));
  return by_next;
}

Result<CalibrationRecord> parse_link(std::string_view canonical, std::string_view expected_previous_sha256,
                                     std::uint64_t expected_sequence) {
  auto parsed = parse_record(canonical);
  if (!parsed) return parsed;
  if (parsed->sequence != expected_sequence)
    return fail(ErrorCode::broken_chain, "it says that it is record " + std::to_string(parsed->sequence) +
                                             " where record " + std::to_string(expected_sequence) + " should be");
  if (parsed->previous_sha256 != expected_previous_sha256)
    return fail(ErrorCode::broken_chain, "it follows a record with SHA-256 " + parsed->previous_sha256 +
                                             ", but the record before it has " + std::string(expected_previous_sha256));
  return parsed;
}

Result<CalibrationRecord> verify_record(const SignedRecord& record, const PublicKey& key,
                                        std::string_view expected_previous_sha256, std::uint64_t expected_sequence) {
  // The signature first: nothing that nobody signed is parsed.
  if (const auto is_signed = verify_signature(record.canonical, record.signature, key); !is_signed)
    return propagate(is_signed);
  auto parsed = parse_link(record.canonical, expected_previous_sha256, expected_sequence);
  if (parsed && parsed->key_change)
    return fail(ErrorCode::broken_chain, "it is a change of keys, and only one key has signed it");
  return parsed;
}

}  // namespace calib
