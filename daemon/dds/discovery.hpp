#pragma once

#include <string>
#include <vector>

#include "dds/entity.hpp"

namespace calib {

/// A writer of another program, as DDS discovery tells of it. Names are other people's text: escape what is shown.
struct RemoteWriter {
  std::string topic;  // as configuration writes it: /lidar/points, or dds:NAME where that is no ROS topic
  std::string type;   // as `ros_type_name` gives it
  bool reliable = false;
  /// Why none of calibd's readers (best effort, volatile, XCDR1, no partition) can ever match it; empty when they can.
  std::string obstacle;
};

/// All that the participant knows of now, in the order of their topics; at most `max_remote_writers`. Fails with
/// `dds_failed`.
[[nodiscard]] Result<std::vector<RemoteWriter>> remote_writers(dds_entity_t participant);
inline constexpr std::size_t max_remote_writers = 4096;

}  // namespace calib
