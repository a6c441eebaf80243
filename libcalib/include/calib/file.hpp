#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "calib/result.hpp"

namespace calib {

/// The content of a regular file, which symbolic links may lead to. Never waits: a FIFO, a socket, a device or a folder
/// is refused and not opened. No more memory is taken than the file is long.
/// Fails with `file_not_found`, `file_unreadable` or, before anything is read, `file_too_large`.
[[nodiscard]] Result<std::string> read_regular_file(const std::filesystem::path& file, std::uint64_t max_bytes);

/// Makes or replaces a regular file, whole or not at all, by way of FILE.part. Follows no symbolic link: where one has
/// either name, it is replaced, and what it points to stays as it is. Fails with `write_failed`.
[[nodiscard]] Result<void> replace_file(const std::filesystem::path& file, std::string_view bytes);

/// Whether `path` itself is a symbolic link that neither this process's user nor root has made. Who writes where such a
/// link points may write over what its maker could not.
[[nodiscard]] bool is_foreign_link(const std::filesystem::path& path);

}  // namespace calib
