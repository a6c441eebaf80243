#include "dataset/bag/ros_message.hpp"

#if __has_include(<dds/cdr/dds_cdrstream.h>)
#include <dds/cdr/dds_cdrstream.h>  // Cyclone DDS 11
#else
#include <dds/ddsi/ddsi_cdrstream.h>
#endif

#include <array>
#include <cstring>
#include <limits>
#include <new>

namespace calib {
namespace {

/// Brings the bytes, without their header, into this machine's order, and copies what they say into the message. False
/// when they are of another type, or end too early.
#if __has_include(<dds/cdr/dds_cdrstream.h>)
bool read_cdr(char* data, std::uint32_t size, bool is_big_endian, const dds_topic_descriptor_t& type, void* message) {
  static constexpr dds_cdrstream_allocator allocator{dds_alloc, dds_realloc, dds_free};
  dds_cdrstream_desc description{};
  dds_cdrstream_desc_from_topic_desc(&description, &type);
  std::uint32_t used = 0;
  const bool is_of_type = dds_stream_normalize(data, size, is_big_endian, DDSI_RTPS_CDR_ENC_VERSION_1, &description,
                                               false, &used) == DDS_STREAM_NORMALIZE_SUCCESS;
  if (is_of_type) {
    dds_istream_t in;
    dds_istream_init(&in, used, data, DDSI_RTPS_CDR_ENC_VERSION_1);
    dds_stream_read_sample(&in, message, &allocator, &description);
  }
  dds_cdrstream_desc_fini(&description, &allocator);
  return is_of_type;
}
#else
bool read_cdr(char* data, std::uint32_t size, bool is_big_endian, const dds_topic_descriptor_t& type, void* message) {
  constexpr std::uint32_t xcdr1 = 1;  // the only one that ROS 2 writes
  std::uint32_t used = 0;
  if (dds_stream_normalize_data(data, &used, size, is_big_endian, xcdr1, type.m_ops) == nullptr) return false;
  dds_istream_t in;
  dds_istream_init(&in, used, data, xcdr1);
  dds_stream_read(&in, static_cast<char*>(message), type.m_ops);
  return true;
}
#endif

}  // namespace

RosMessage::RosMessage(const dds_topic_descriptor_t& type) : message_(dds_alloc(type.m_size), Free{&type}) {
  if (!message_) throw std::bad_alloc();
  std::memset(message_.get(), 0, type.m_size);
}

Result<RosMessage> RosMessage::read(Octets serialized, const MessageType& type) {
  constexpr std::size_t header_bytes = 4;
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
  RosMessage message(*type.descriptor);
  if (!read_cdr(data, size, is_big_endian, *type.descriptor, message.message_.get()))
    return refuse("cut short, or of another type than the recording says");
  return message;
}

}  // namespace calib
