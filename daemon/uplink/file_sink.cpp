#include "uplink/file_sink.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <utility>

#include "sync_folder.hpp"

namespace calib::uplink {
namespace {

/// How much of the file ends with a line's end.
std::uint64_t whole_lines(int fd, std::uint64_t size) {
  std::array<char, 4096> block;
  while (size > 0) {
    const std::uint64_t begin = size - std::min<std::uint64_t>(size, block.size());
    const ssize_t count = ::pread(fd, block.data(), size - begin, static_cast<off_t>(begin));
    if (count <= 0) return size;
    for (ssize_t i = count; i > 0; --i)
      if (block[i - 1] == '\n') return begin + static_cast<std::uint64_t>(i);
    size = begin;
  }
  return 0;
}

}  // namespace

FileSink::FileSink(FileSink&& other) noexcept
    : config_(std::move(other.config_)), fd_(std::exchange(other.fd_, -1)), size_(other.size_) {}

FileSink::~FileSink() {
  if (fd_ >= 0) ::close(fd_);
}

Error FileSink::error(const char* what) const {
  return {ErrorCode::write_failed, config_.path.string() + " cannot be " + what + ": " + std::strerror(errno)};
}

Result<FileSink> FileSink::open(FileConfig config) {
  FileSink sink(std::move(config));
  if (auto opened = sink.open_file(); !opened) return propagate(opened);
  return sink;
}

Result<void> FileSink::open_file() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = ::open(config_.path.c_str(), O_RDWR | O_CREAT | O_APPEND | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0640);
  struct stat about {};
  if (fd_ < 0 || ::fstat(fd_, &about) != 0) return tl::unexpected(error("opened"));
  if (!S_ISREG(about.st_mode)) return fail(ErrorCode::write_failed, config_.path.string() + " is no regular file");
  size_ = whole_lines(fd_, static_cast<std::uint64_t>(about.st_size));
  if (::ftruncate(fd_, static_cast<off_t>(size_)) != 0) return tl::unexpected(error("cut"));
  if (!sync_folder(config_.path.parent_path())) return tl::unexpected(error("made durable"));
  return {};
}

Result<void> FileSink::rotate() {
  if (auto synced = sync(); !synced) return synced;
  const auto name = [&](int number) {
    return config_.path.string() + (number > 0 ? "." + std::to_string(number) : "");
  };
  for (int number = config_.keep; number > 0; --number)
    if (::rename(name(number - 1).c_str(), name(number).c_str()) != 0 && errno != ENOENT)
      return tl::unexpected(error("renamed"));
  return open_file();
}

Result<void> FileSink::append(std::string_view event) {
  if (fd_ < 0 || (size_ > 0 && size_ + event.size() + 1 > config_.max_bytes))
    if (auto ready = fd_ < 0 ? open_file() : rotate(); !ready) return ready;
  const std::string line = std::string(event) + '\n';
  const ssize_t written = ::write(fd_, line.data(), line.size());
  if (written == static_cast<ssize_t>(line.size())) {
    size_ += line.size();
    return {};
  }
  const Error failure = error("written");  // by the disk that is full, for example
  if (::ftruncate(fd_, static_cast<off_t>(size_)) != 0) {
    ::close(std::exchange(fd_, -1));  // it is cut when it is opened again
  }
  return tl::unexpected(failure);
}

Result<void> FileSink::sync() const {
  if (::fdatasync(fd_) != 0) return tl::unexpected(error("written to the disk"));
  return {};
}

}  // namespace calib::uplink
