#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "calib/frame.hpp"
#include "dataset/bag/byte_source.hpp"

namespace calib {

/// Types of messages as ROS 2 names them.
namespace bag_type {
inline constexpr std::string_view image = "sensor_msgs/msg/Image", compressed_image = "sensor_msgs/msg/CompressedImage",
                                  camera_info = "sensor_msgs/msg/CameraInfo", cloud = "sensor_msgs/msg/PointCloud2",
                                  disparity = "stereo_msgs/msg/DisparityImage", transforms = "tf2_msgs/msg/TFMessage";
}  // namespace bag_type

struct BagTopic {
  std::string name, type;
  /// How messages are written: "cdr" in ROS 2.
  std::string encoding;
  std::uint64_t messages = 0;
  [[nodiscard]] bool is(std::string_view wanted) const { return type == wanted && encoding == "cdr"; }
  /// Whether its messages are listed: those of the types above.
  [[nodiscard]] bool is_listed() const;
};

/// A message in a file of a recording, and where it is.
struct BagMessage {
  std::uint32_t topic = 0;  // of the file's topics
  std::uint32_t chunk = 0;
  std::uint64_t at = 0, size = 0;
  /// Of its header; `no_stamp` for TFMessage, and for a header that is none.
  Timestamp stamp{};
  static constexpr Timestamp no_stamp = Timestamp::min();
};

/// What a file of a recording holds.
struct BagList {
  std::vector<BagTopic> topics;
  /// Of the types above, in the order of the file.
  std::vector<BagMessage> messages;
  /// What is wrong with the file, a sentence each.
  std::vector<std::string> remarks;

  /// The number of the topic, which is added where it is new; nothing when there is no room for it.
  std::optional<std::uint32_t> add(BagTopic topic);
};

/// One file of a recording. All is listed when it is opened; messages are read when they are asked for.
class BagStorage {
 public:
  virtual ~BagStorage() = default;
  [[nodiscard]] const std::vector<BagTopic>& topics() const { return list_.topics; }
  [[nodiscard]] const std::vector<BagMessage>& messages() const { return list_.messages; }
  [[nodiscard]] const std::vector<std::string>& remarks() const { return list_.remarks; }
  void add_remark(std::string sentence) { list_.remarks.push_back(std::move(sentence)); }
  /// The message as its sender serialised it: four bytes that tell the encoding, then CDR. From any thread.
  /// Fails with `file_unreadable`.
  [[nodiscard]] virtual Result<Octets> read(const BagMessage& message) const = 0;

  /// No message is larger, nor any chunk of an MCAP file.
  static constexpr std::uint64_t most_bytes = std::uint64_t{512} << 20;
  /// Of the listed ones, in a file.
  static constexpr std::size_t most_messages = 8'000'000;
  static constexpr std::size_t most_topics = 10'000, longest_name = 512;

 protected:
  [[nodiscard]] BagList& list() { return list_; }

 private:
  BagList list_;
};

/// As many bytes of a message as a stamp needs.
inline constexpr std::size_t stamp_bytes = 12;
/// The stamp of a message that begins with a header, from the first `stamp_bytes` of it.
[[nodiscard]] Timestamp stamp_in(std::span<const std::uint8_t> bytes);

/// MCAP (https://mcap.dev/spec), chunks uncompressed or with lz4 or zstd, without using its indexes: a file that ends
/// early holds what comes before its end. `name` is for messages. Fails with `file_unreadable` when it is none.
[[nodiscard]] Result<std::unique_ptr<BagStorage>> open_mcap(std::unique_ptr<ByteSource> file, const std::string& name);

/// SQLite, as rosbag2 writes it: tables topics and messages. `path` may be removed once this has returned. Fails with
/// `file_unreadable`.
[[nodiscard]] Result<std::unique_ptr<BagStorage>> open_sqlite_bag(const std::filesystem::path& path,
                                                                  const std::string& name);

/// Either, by its first bytes; also when rosbag2 has compressed the whole file.
[[nodiscard]] Result<std::unique_ptr<BagStorage>> open_bag_storage(const std::filesystem::path& path);

}  // namespace calib
