#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>

#include "calib/signature.hpp"

namespace calib {

/// The state of a pair with the evidence that was gathered since its last decision, whose state is in the store.
struct StateSince {
  std::string follows;  // MAC of the state in the store: with another one there, this one is obsolete
  std::string state;    // as `to_text` makes it
};

/// By pair. Kept beside the store, since this is what is written most often, once a minute: a transaction of SQLite
/// writes 16 KiB at least, half of it the index of its log. Two files are overwritten in place and in turn: this
/// allocates nothing, so that it costs the blocks of the data and an inode. After a power cut in the middle of a write
/// the other file counts. Their content is CBOR, half as long as text.
struct Evidence {
  std::uint64_t number = 0;  // rises by one with each write; odd and even ones have a file each
  std::map<std::string, StateSince, std::less<>> pairs{};
};

/// Reads `folder`/evidence-0 and evidence-1: the later one that is complete; empty when there are none. Fails with
/// `malformed_state` when none is complete and authenticated with this key.
[[nodiscard]] Result<Evidence> read_evidence(const std::filesystem::path& folder, const SigningKey& key);
/// Durable when it returns. Fails with `store_failed`.
[[nodiscard]] Result<void> write_evidence(const std::filesystem::path& folder, const Evidence& evidence,
                                          const SigningKey& key);

}  // namespace calib
