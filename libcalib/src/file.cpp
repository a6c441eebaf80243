#include "calib/file.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <system_error>
#include <utility>

namespace calib {
namespace {

struct Descriptor {
  int number;
  ~Descriptor() {
    if (number >= 0) ::close(number);
  }
};

std::string last_error() { return std::error_code(errno, std::generic_category()).message(); }

std::string kind_of(mode_t mode) {
  if (S_ISREG(mode)) return "a regular file";
  if (S_ISDIR(mode)) return "a folder";
  if (S_ISFIFO(mode)) return "a FIFO";
  if (S_ISSOCK(mode)) return "a socket";
  return "a device";
}

tl::unexpected<Error> unreadable(const std::filesystem::path& file, const std::string& why) {
  return fail(ErrorCode::file_unreadable, file.string() + ": cannot be read: " + why);
}

std::string size_in_words(std::uint64_t bytes) {
  if (bytes % (1 << 20) == 0) return std::to_string(bytes >> 20) + " MiB";
  if (bytes % (1 << 10) == 0) return std::to_string(bytes >> 10) + " KiB";
  return std::to_string(bytes) + " bytes";
}

bool write_all(int descriptor, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(descriptor, bytes.data(), bytes.size());
    if (written < 0 && errno != EINTR) return false;
    if (written > 0) bytes.remove_prefix(static_cast<std::size_t>(written));
  }
  return true;
}

/// False, with errno, when `file` is there already or cannot be written in full.
bool write_new(const std::string& file, std::string_view bytes) {
  Descriptor out{::open(file.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC, 0666)};
  if (out.number < 0 || !write_all(out.number, bytes)) return false;
  const int number = std::exchange(out.number, -1);
  return ::close(number) == 0;  // where some file systems report that the disk is full
}

}  // namespace

Result<std::string> read_regular_file(const std::filesystem::path& file, std::uint64_t max_bytes) {
  struct stat about {};
  if (::stat(file.c_str(), &about) != 0) {
    const bool missing = errno == ENOENT || errno == ENOTDIR;
    return fail(missing ? ErrorCode::file_not_found : ErrorCode::file_unreadable,
                file.string() + ": cannot be read: " + last_error());
  }
  // Asked twice: opening a device may already do something, and the name may lead elsewhere by then.
  if (!S_ISREG(about.st_mode)) return unreadable(file, "it is " + kind_of(about.st_mode));
  const Descriptor in{::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY)};
  if (in.number < 0 || ::fstat(in.number, &about) != 0) return unreadable(file, last_error());
  if (!S_ISREG(about.st_mode)) return unreadable(file, "it is " + kind_of(about.st_mode));
  const auto size = static_cast<std::uint64_t>(about.st_size);
  if (size > max_bytes)
    return fail(ErrorCode::file_too_large, file.string() + ": is larger than " + size_in_words(max_bytes));

  std::string bytes(size, '\0');
  std::size_t length = 0;
  while (length < bytes.size()) {
    const ssize_t got = ::read(in.number, bytes.data() + length, bytes.size() - length);
    if (got < 0 && errno != EINTR) return unreadable(file, last_error());
    if (got == 0) break;  // it has become shorter meanwhile
    if (got > 0) length += static_cast<std::size_t>(got);
  }
  bytes.resize(length);
  return bytes;
}

Result<void> replace_file(const std::filesystem::path& file, std::string_view bytes) {
  const auto refuse = [&](const std::string& why) {
    return fail(ErrorCode::write_failed, file.string() + " cannot be written: " + why);
  };
  struct stat about {};
  if (::lstat(file.c_str(), &about) == 0 && !S_ISREG(about.st_mode) && !S_ISLNK(about.st_mode))
    return refuse("it is " + kind_of(about.st_mode));
  const std::string part = file.string() + ".part";
  ::unlink(part.c_str());  // what a program left that was stopped, or somebody has put there
  if (write_new(part, bytes) && ::rename(part.c_str(), file.c_str()) == 0) return {};
  const std::string why = last_error();
  ::unlink(part.c_str());
  return refuse(why);
}

bool is_foreign_link(const std::filesystem::path& path) {
  // With a slash at its end a name is that of the folder behind the link.
  const std::filesystem::path itself = path.has_filename() ? path : path.parent_path();
  struct stat about {};
  return ::lstat(itself.c_str(), &about) == 0 && S_ISLNK(about.st_mode) && about.st_uid != 0 &&
         about.st_uid != ::geteuid();
}

}  // namespace calib
