#include "dataset/bag/bag_storage.hpp"

#include <algorithm>
#include <array>
#include <limits>
#include <string_view>

#include "dataset/bag/decompress.hpp"

namespace calib {

bool BagTopic::is_listed() const {
  using namespace bag_type;
  return encoding == "cdr" && (type == image || type == compressed_image || type == camera_info || type == cloud ||
                               type == disparity || type == transforms);
}

std::optional<std::uint32_t> BagList::add(BagTopic topic) {
  const auto known = std::ranges::find_if(topics, [&](const BagTopic& other) {
    return other.name == topic.name && other.type == topic.type && other.encoding == topic.encoding;
  });
  const auto number = static_cast<std::uint32_t>(known - topics.begin());
  if (known != topics.end()) return number;
  if (topics.size() >= BagStorage::most_topics || topic.name.size() > BagStorage::longest_name ||
      topic.type.size() > BagStorage::longest_name)
    return std::nullopt;
  topics.push_back(std::move(topic));
  return number;
}

Timestamp stamp_in(std::span<const std::uint8_t> bytes) {
  if (bytes.size() < stamp_bytes || bytes[0] != 0 || bytes[1] > 1) return BagMessage::no_stamp;
  std::array<std::uint8_t, 4> sec{}, nanosec{};
  std::copy_n(bytes.begin() + 4, 4, sec.begin());
  std::copy_n(bytes.begin() + 8, 4, nanosec.begin());
  if (bytes[1] == 0) {  // big endian
    std::ranges::reverse(sec);
    std::ranges::reverse(nanosec);
  }
  const auto little_endian = [](const std::array<std::uint8_t, 4>& b) {
    return std::uint32_t{b[0]} | std::uint32_t{b[1]} << 8 | std::uint32_t{b[2]} << 16 | std::uint32_t{b[3]} << 24;
  };
  const std::uint32_t s = little_endian(sec), ns = little_endian(nanosec);
  if (s > static_cast<std::uint32_t>(std::numeric_limits<std::int32_t>::max()) || ns >= 1'000'000'000)
    return BagMessage::no_stamp;
  return std::chrono::seconds(s) + std::chrono::nanoseconds(ns);
}

Result<std::unique_ptr<BagStorage>> open_bag_storage(const std::filesystem::path& path) {
  const auto open_plain = [&](const std::filesystem::path& plain) -> Result<std::unique_ptr<BagStorage>> {
    auto file = open_file(plain);
    if (!file) return propagate(file);
    std::array<std::uint8_t, 16> magic{};
    (void)(*file)->read(0, std::span(magic).first(std::min<std::uint64_t>(magic.size(), (*file)->size())));
    const std::string_view first(reinterpret_cast<const char*>(magic.data()), magic.size());
    if (first.starts_with("\x89MCAP0\r\n")) return open_mcap(*std::move(file), path.string());
    if (first == std::string_view("SQLite format 3\0", 16)) return open_sqlite_bag(plain, path.string());
    if (first.starts_with("#ROSBAG"))
      return fail(ErrorCode::file_unreadable,
                  path.string() + " is a recording of ROS 1; rosbags-convert makes one of ROS 2 of it");
    return fail(ErrorCode::file_unreadable, path.string() + " is neither MCAP nor SQLite");
  };
  const auto file = open_file(path);
  if (!file) return propagate(file);
  std::array<std::uint8_t, 4> magic{};
  if (!(*file)->read(0, magic) || !is_zstd(magic)) return open_plain(path);
  const auto plain = decompress_zstd_file(**file);
  if (!plain) return propagate(plain);
  auto storage = open_plain(plain->file->path());
  if (storage && !plain->complete)
    (*storage)->add_remark(path.string() + " is cut short or damaged: what was compressed before that is read");
  return storage;
}

}  // namespace calib
