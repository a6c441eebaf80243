#pragma once

#include <algorithm>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace calib::test {

/// The bytes of an MCAP file, record by record, as its specification has them.
class McapBytes {
 public:
  using Octets = std::vector<std::uint8_t>;

  McapBytes& number(std::uint64_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) octets_.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
    return *this;
  }
  McapBytes& raw(std::string_view bytes) {
    octets_.insert(octets_.end(), bytes.begin(), bytes.end());
    return *this;
  }
  McapBytes& raw(const Octets& bytes) {
    octets_.insert(octets_.end(), bytes.begin(), bytes.end());
    return *this;
  }
  McapBytes& text(std::string_view value) { return number(value.size(), 4).raw(value); }
  McapBytes& record(std::uint8_t opcode, const McapBytes& content) {
    return number(opcode, 1).number(content.octets_.size(), 8).raw(content.octets_);
  }
  McapBytes& magic() { return raw("\x89MCAP0\r\n"); }
  McapBytes& header() { return record(0x01, McapBytes().text("ros2").text("")); }
  McapBytes& schema(std::uint16_t id, std::string_view name) {
    return record(0x03, McapBytes().number(id, 2).text(name).text("ros2msg").text(""));
  }
  McapBytes& channel(std::uint16_t id, std::uint16_t schema, std::string_view topic,
                     std::string_view encoding = "cdr") {
    return record(0x04, McapBytes().number(id, 2).number(schema, 2).text(topic).text(encoding).number(0, 4));
  }
  McapBytes& message(std::uint16_t channel, const Octets& data) {
    return record(0x05, McapBytes().number(channel, 2).number(0, 4).number(0, 8).number(0, 8).raw(data));
  }
  McapBytes& chunk(const McapBytes& records, std::string_view compression = "", std::uint64_t uncompressed_size = 0) {
    const std::uint64_t size = records.octets_.size();
    return record(0x06, McapBytes()
                            .number(0, 8)
                            .number(0, 8)
                            .number(uncompressed_size > 0 ? uncompressed_size : size, 8)
                            .number(0, 4)
                            .text(compression)
                            .number(size, 8)
                            .raw(records.octets_));
  }
  /// What ends a file, without a summary.
  McapBytes& end() {
    return record(0x0F, McapBytes().number(0, 4))
        .record(0x02, McapBytes().number(0, 8).number(0, 8).number(0, 4))
        .magic();
  }

  [[nodiscard]] const Octets& octets() const { return octets_; }

 private:
  Octets octets_;
};

/// The begin of a serialised message with a header: little endian, stamp, a frame's name.
inline McapBytes::Octets stamped_cdr(std::uint32_t sec, std::uint32_t nanosec, std::string_view frame = "lidar") {
  McapBytes bytes;
  bytes.number(0x00000100, 4).number(sec, 4).number(nanosec, 4).number(frame.size() + 1, 4).raw(frame).number(0, 1);
  return bytes.octets();
}

}  // namespace calib::test
