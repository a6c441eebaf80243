#pragma once

#include <cstdint>
#include <string_view>

#include "uplink/uplink_config.hpp"

namespace calib::uplink {

/// Events as lines of JSON in a file. When it would become too long, it gets the name FILE.1, what had that name
/// FILE.2, and so on.
class FileSink {
 public:
  /// Makes the file, or goes on where it ends; what a crash has left of a line is cut off. Fails with `write_failed`.
  [[nodiscard]] static Result<FileSink> open(FileConfig config);
  FileSink(FileSink&& other) noexcept;
  FileSink& operator=(FileSink&&) = delete;
  ~FileSink();

  /// A line is on the disk once `sync` has succeeded after it. Both fail with `write_failed`; a line is then written
  /// whole or not at all.
  [[nodiscard]] Result<void> append(std::string_view event);
  [[nodiscard]] Result<void> sync() const;

 private:
  explicit FileSink(FileConfig config) : config_(std::move(config)) {}
  [[nodiscard]] Result<void> open_file();
  [[nodiscard]] Result<void> rotate();
  [[nodiscard]] Error error(const char* what) const;

  FileConfig config_;
  int fd_ = -1;
  std::uint64_t size_ = 0;
};

}  // namespace calib::uplink
