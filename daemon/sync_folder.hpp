#pragma once

#include <fcntl.h>
#include <unistd.h>

#include <filesystem>

namespace calib {

/// Makes the names in a folder durable; whether that worked.
inline bool sync_folder(const std::filesystem::path& folder) {
  const int fd = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  const bool synced = fd >= 0 && ::fsync(fd) == 0;
  if (fd >= 0) ::close(fd);
  return synced;
}

}  // namespace calib
