#include "dataset/bag/ros_message.hpp"

#include <dds/ddsi/ddsi_cdrstream.h>

#include <array>
#include <cstring>
#include <limits>
#include <new>

namespace calib {

RosMessage::RosMessage(const dds_topic_descriptor_t& type) : message_(dds_alloc(type.m_size), Free{&type}) {
  if (!message_) throw std::bad_alloc();
  std::memset(message_.get(), 0, type.m_size);
}

Result<RosMessage> RosMessage::read(Octets serialized, const MessageType& type) {
  constexpr std::size_t header_bytes = 4;
  constexpr std::uint32_t xcdr1 = 1;  // the only one that ROS 2 writes
  const auto refuse = [&](const char* why) {
    return fail(ErrorCode::malformed_refused, std::string("the bytes of a message are ") + why);
  };
  if (serialized.size() < header_bytes || serialized[0] != 0 || serialized[1] > 1) return refuse("not plain CDR");
  if (serialized.size() > std::numeric_limits<std::int32_t>::max()) return refuse("too many");
  const bool is_big_endian = serialized[1] == 0;
  // Numbers are aligned to the begin of what follows the header.
  serialized.erase(serialized.begin(), serialized.begin() + header_bytes);
  serialized.reserve(1);  // Cyclone wants an address of nothing too
  auto* const data = reinterpret_cast<char*>(serialized.data());
  const auto size = static_cast<std::uint32_t>(serialized.size());
  std::uint32_t used = 0;
  if (dds_stream_normalize_data(data, &used, size, is_big_endian, xcdr1, type.descriptor->m_ops) == nullptr)
    return refuse("cut short, or of another type than the recording says");
  RosMessage message(*type.descriptor);
  dds_istream_t in;
  dds_istream_init(&in, used, data, xcdr1);
  dds_stream_read(&in, static_cast<char*>(message.message_.get()), type.descriptor->m_ops);
  return message;
}

}  // namespace calib
