#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "calib/result.hpp"

namespace calib {

using Octets = std::vector<std::uint8_t>;

/// Bytes that are read piece by piece, from any thread.
class ByteSource {
 public:
  virtual ~ByteSource() = default;
  [[nodiscard]] virtual std::uint64_t size() const = 0;
  /// Fills `into` with the bytes from `offset` on; false when there are not so many, or when reading fails.
  [[nodiscard]] virtual bool read(std::uint64_t offset, std::span<std::uint8_t> into) const = 0;
};

/// A part of another source, which must live as long.
class PartOfSource : public ByteSource {
 public:
  PartOfSource(const ByteSource& whole, std::uint64_t offset, std::uint64_t size)
      : whole_(whole), offset_(offset), size_(size) {}
  [[nodiscard]] std::uint64_t size() const override { return size_; }
  [[nodiscard]] bool read(std::uint64_t offset, std::span<std::uint8_t> into) const override {
    return offset <= size_ && into.size() <= size_ - offset && whole_.read(offset_ + offset, into);
  }

 private:
  const ByteSource& whole_;
  std::uint64_t offset_, size_;
};

/// Bytes in memory.
class OctetSource : public ByteSource {
 public:
  explicit OctetSource(Octets octets) : octets_(std::move(octets)) {}
  [[nodiscard]] std::uint64_t size() const override { return octets_.size(); }
  [[nodiscard]] bool read(std::uint64_t offset, std::span<std::uint8_t> into) const override;

 private:
  Octets octets_;
};

/// A regular file. Fails with `file_not_found` or `file_unreadable`; a FIFO, a device or a folder is not opened.
[[nodiscard]] Result<std::unique_ptr<ByteSource>> open_file(const std::filesystem::path& path);

/// A file that is removed at the end of its life.
class TemporaryFile {
 public:
  explicit TemporaryFile(std::filesystem::path path) : path_(std::move(path)) {}
  TemporaryFile(const TemporaryFile&) = delete;
  TemporaryFile& operator=(const TemporaryFile&) = delete;
  ~TemporaryFile() {
    std::error_code ignored;
    std::filesystem::remove(path_, ignored);
  }
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace calib
