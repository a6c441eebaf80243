#pragma once

#include <dds/dds.h>

#include <string_view>
#include <utility>

#include "calib/result.hpp"

namespace calib {

/// Owns one Cyclone entity, and with it the entities made from it.
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

/// What Cyclone returned: the entity, or `dds_failed` with `what` was tried and Cyclone's own words.
[[nodiscard]] Result<Entity> own(dds_entity_t returned, std::string_view what);
[[nodiscard]] Result<void> check(dds_return_t returned, std::string_view what);

/// A type as it goes over the wire: Cyclone's descriptor and the hash by which ROS 2 (Iron and later) knows
/// it.
struct MessageType {
  const dds_topic_descriptor_t* descriptor;
  std::string_view rihs01;
};

/// How a reader or writer keeps samples. `durable` is TRANSIENT_LOCAL (late readers get the last `depth`),
/// else VOLATILE.
struct Keeping {
  bool reliable = false;
  bool durable = false;
  int depth = 1;
};

/// Topic and endpoint in one call; both live as long as `topic_and_endpoint`. XCDR1 always: ROS 2 allows
/// nothing else.
struct Endpoint {
  Entity topic;
  Entity endpoint;
};
[[nodiscard]] Result<Endpoint> make_reader(dds_entity_t participant, const MessageType& type,
                                           std::string_view topic, const Keeping& keeping);
[[nodiscard]] Result<Endpoint> make_writer(dds_entity_t participant, const MessageType& type,
                                           std::string_view topic, const Keeping& keeping);

}  // namespace calib
