#include "dataset/bag/byte_source.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <system_error>

namespace calib {
namespace {

class FileSource : public ByteSource {
 public:
  FileSource(int descriptor, std::uint64_t size) : descriptor_(descriptor), size_(size) {}
  FileSource(const FileSource&) = delete;
  FileSource& operator=(const FileSource&) = delete;
  ~FileSource() override { ::close(descriptor_); }
  [[nodiscard]] std::uint64_t size() const override { return size_; }
  [[nodiscard]] bool read(std::uint64_t offset, std::span<std::uint8_t> into) const override {
    if (offset > size_ || into.size() > size_ - offset) return false;
    while (!into.empty()) {
      const ssize_t count = ::pread(descriptor_, into.data(), into.size(), static_cast<off_t>(offset));
      if (count == 0 || (count < 0 && errno != EINTR)) return false;
      if (count < 0) continue;
      into = into.subspan(static_cast<std::size_t>(count));
      offset += static_cast<std::uint64_t>(count);
    }
    return true;
  }

 private:
  int descriptor_;
  std::uint64_t size_;
};

}  // namespace

bool OctetSource::read(std::uint64_t offset, std::span<std::uint8_t> into) const {
  if (offset > octets_.size() || into.size() > octets_.size() - offset) return false;
  std::copy_n(octets_.begin() + static_cast<std::ptrdiff_t>(offset), into.size(), into.begin());
  return true;
}

Result<std::unique_ptr<ByteSource>> open_file(const std::filesystem::path& path) {
  const auto reason = [] { return std::error_code(errno, std::generic_category()).message(); };
  struct stat facts {};
  if (::stat(path.c_str(), &facts) != 0)
    return fail(ErrorCode::file_not_found, path.string() + ": cannot be read: " + reason());
  if (!S_ISREG(facts.st_mode)) return fail(ErrorCode::file_unreadable, path.string() + " is not a regular file");
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_NONBLOCK | O_CLOEXEC);
  if (descriptor < 0) return fail(ErrorCode::file_unreadable, path.string() + ": cannot be read: " + reason());
  if (::fstat(descriptor, &facts) != 0 || !S_ISREG(facts.st_mode)) {
    ::close(descriptor);
    return fail(ErrorCode::file_unreadable, path.string() + " is not a regular file");
  }
  return std::make_unique<FileSource>(descriptor, static_cast<std::uint64_t>(facts.st_size));
}

}  // namespace calib
