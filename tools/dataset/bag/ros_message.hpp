#pragma once

#include <memory>

#include "dataset/bag/byte_source.hpp"
#include "dds/entity.hpp"
#include "dds/messages.hpp"

namespace calib {

/// A recorded message, taken from its bytes as Cyclone takes one that arrives: what calibd's decoders are given.
class RosMessage {
 public:
  /// `serialized`: four bytes that tell the encoding, then CDR. Fails with `malformed:refused` when the bytes are no
  /// message of the type.
  [[nodiscard]] static Result<RosMessage> read(Octets serialized, const MessageType& type);

  /// Of the type that it was read as.
  template <typename Message>
  [[nodiscard]] const Message& as() const {
    return *static_cast<const Message*>(message_.get());
  }

 private:
  struct Free {
    const dds_topic_descriptor_t* type;
    void operator()(void* message) const { dds_sample_free(message, type, DDS_FREE_ALL); }
  };
  explicit RosMessage(const dds_topic_descriptor_t& type);
  std::unique_ptr<void, Free> message_;
};

}  // namespace calib
