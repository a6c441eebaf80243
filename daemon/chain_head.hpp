#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "calib/record.hpp"
#include "calib/signature.hpp"

namespace calib {

/// Number and hash of the last record of a chain, kept in a folder of its own. The chain alone cannot show that its
/// last records were cut off, or that an older store was put back.
struct ChainHead {
  std::uint64_t sequence = 0;
  std::string sha256{no_previous_sha256};
  /// A sentence about records that are missing; until a record contains it.
  std::optional<std::string> missing;
};

/// Reads `folder`/chain-head.json; nothing when there is none. Fails with `malformed_head`, also for a file that
/// another key has authenticated; null accepts that of any key, where the right one is lost.
[[nodiscard]] Result<std::optional<ChainHead>> read_chain_head(const std::filesystem::path& folder,
                                                               const SigningKey* key);
/// Replaces it in one step, durably. With `next`, the file counts for that key, too: while one key replaces the other,
/// either may be the one that reads it. Fails with `store_failed`.
[[nodiscard]] Result<void> write_chain_head(const std::filesystem::path& folder, const ChainHead& head,
                                            const SigningKey& key, const SigningKey* next = nullptr);

}  // namespace calib
