#pragma once

#include <dds/dds.h>

#include <string_view>
#include <utility>

#include "calib/result.hpp"

namespace calib {

/// Owns a Cyclone entity and the entities that were created from it.
class Entity {
 public:
  Entity() = default;
  explicit Entity(dds_entity_t entity) : entity_(entity) {}
  Entity(Entity&& other) noexcept : entity_(std::exchange(other.entity_, 0)) {}
  Entity& operator=(Entity&& other) noexcept {
    std::swap(entity_, other.entity_);
    return *this;
  }
  ~Entity() {
    if (entity_ > 0) dds_delete(entity_);
  }
  [[nodiscard]] dds_entity_t get() const { return entity_; }

 private:
  dds_entity_t entity_ = 0;
};

/// Takes ownership of an entity that Cyclone returned. Fails with `dds_failed`, `what` was tried and Cyclone's message.
[[nodiscard]] Result<Entity> own(dds_entity_t returned, std::string_view what);
/// Fails likewise if Cyclone returned an error.
[[nodiscard]] Result<void> check(dds_return_t returned, std::string_view what);

/// A type of DDS messages: Cyclone's descriptor, and the type hash (REP 2016) that ROS 2 Iron and later announce.
struct MessageType {
  const dds_topic_descriptor_t* descriptor;
  std::string_view rihs01;
};

/// Quality of service of a reader or writer. `durable` is TRANSIENT_LOCAL (late readers get the last `depth` samples),
/// otherwise VOLATILE.
struct QosProfile {
  bool reliable = false;
  bool durable = false;
  int depth = 1;
};

/// A reader or writer and its topic. The representation is always XCDR1, the only one that ROS 2 allows.
struct Endpoint {
  Entity topic;
  Entity endpoint;
};
[[nodiscard]] Result<Endpoint> make_reader(dds_entity_t participant, const MessageType& type, std::string_view topic,
                                           const QosProfile& profile);
[[nodiscard]] Result<Endpoint> make_writer(dds_entity_t participant, const MessageType& type, std::string_view topic,
                                           const QosProfile& profile);

}  // namespace calib
