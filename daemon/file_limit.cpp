#include "file_limit.hpp"

#include <fmt/format.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cstring>
#include <vector>

namespace calib {
namespace {

/// About 15 for DDS, store, socket and signals, 16 for askers on the control socket, and some for files that are read
/// and written in passing.
constexpr std::size_t needed = 48;

}  // namespace

Result<void> require_open_files() {
  std::vector<int> opened;
  int fd = 0;
  while (opened.size() < needed && (fd = eventfd(0, EFD_CLOEXEC)) >= 0) opened.push_back(fd);
  const int error = errno;
  for (const int open : opened) close(open);
  if (opened.size() == needed) return {};
  rlimit limit{};
  getrlimit(RLIMIT_NOFILE, &limit);
  return fail(ErrorCode::too_few_files,
              fmt::format("only {} files can be opened, and calibd needs {} ({}; the limit is {}): raise it with "
                          "LimitNOFILE= in the unit, or `ulimit -n` in a shell",
                          opened.size(), needed, std::strerror(error), limit.rlim_cur));
}

}  // namespace calib
