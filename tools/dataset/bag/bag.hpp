#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "dataset/bag/bag_storage.hpp"

namespace calib {

/// A recording of rosbag2: one file, or a folder of files that follow each other. All its messages are listed when it
/// is opened, which reads it once (SQLite, and MCAP without compression: only where messages begin); memory holds the
/// list and one chunk.
class Bag {
 public:
  struct Message {
    std::uint32_t file = 0;
    BagMessage place;
  };
  using Messages = std::vector<Message>;

  /// `path` is a file (.mcap, .db3, or either compressed with zstd), or a folder: its metadata.yaml names the files and
  /// their order; without one all such files belong to it, by the numbers in their names. metadata.yaml stands for its
  /// folder. A file that cannot be read is a remark, where another one can. Fails with `recording_not_found` or
  /// `file_unreadable`.
  [[nodiscard]] static Result<Bag> open(const std::filesystem::path& path);

  /// Of all files.
  [[nodiscard]] const std::vector<BagTopic>& topics() const { return topics_; }
  [[nodiscard]] const std::vector<std::string>& remarks() const { return remarks_; }
  /// In the order of the files.
  [[nodiscard]] Messages messages(const BagTopic& topic) const;
  /// From any thread. Fails with `file_unreadable`.
  [[nodiscard]] Result<Octets> read(const Message& message) const;

 private:
  std::vector<std::shared_ptr<const BagStorage>> files_;
  std::vector<BagTopic> topics_;
  std::vector<std::string> remarks_;
};

}  // namespace calib
