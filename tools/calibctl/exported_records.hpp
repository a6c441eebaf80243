#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "stored_records.hpp"

namespace calib::ctl {

/// Bytes; larger than any record and any signature.
inline constexpr std::uint64_t largest_export = 2 << 20;

/// Exported records, each signed with a key that is valid for its number: with the trusted one, or with one that
/// changes of keys among these files lead to. Files of signatures are looked up beside their records. Positions in the
/// chain are not checked.
[[nodiscard]] Result<std::vector<Chain::Link>> read_exported(const std::vector<std::filesystem::path>& files,
                                                             const PublicKey& trusted);

}  // namespace calib::ctl
