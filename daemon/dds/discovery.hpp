#pragma once

#include <string>
#include <vector>

#include "dds/entity.hpp"

namespace calib {

/// A writer of another program, from DDS discovery. Topic and type are untrusted text: escape them before showing them.
struct RemoteWriter {
  std::string topic;  // as in the configuration: /lidar/points, or dds:NAME if it is not a ROS topic
  std::string type;   // from `ros_type_name`
  bool reliable = false;
  /// Why it cannot match calibd's readers (best effort, volatile, XCDR1, no partition); empty when it can.
  std::string obstacle;
};

/// All writers that the participant has discovered, ordered by topic; at most `max_remote_writers`. Fails with
/// `dds_failed`.
[[nodiscard]] Result<std::vector<RemoteWriter>> remote_writers(dds_entity_t participant);
inline constexpr std::size_t max_remote_writers = 4096;

}  // namespace calib
