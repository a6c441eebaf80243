#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "calib/geometry.hpp"
#include "calib/result.hpp"

namespace calib::formats {

/// The pose of frame `child` in frame `parent`: p_parent = T_parent_child p_child.
struct FrameEdge {
  std::string parent, child;
  RigidTransform T_parent_child;
  std::string where;  // FILE or FILE:LINE, for errors
};

/// Frames and the transforms between them that files state.
class FrameGraph {
 public:
  /// Fails with `calibration_malformed` when the same two frames already have another transform.
  [[nodiscard]] Result<void> add(FrameEdge edge);

  /// T_to_from along the shortest chain of transforms, none of which touches the frame `avoid`. Fails with `not_found`
  /// when a frame is unknown (the known ones are listed), or when no chain connects them.
  [[nodiscard]] Result<RigidTransform> transform(const std::string& to, const std::string& from,
                                                 std::string_view avoid = "") const;

  [[nodiscard]] bool knows(const std::string& frame) const { return neighbours_.contains(frame); }
  /// For an error: `a, b, c`; at most the first 20.
  [[nodiscard]] std::string listed() const;

 private:
  struct Neighbour {
    std::string frame;
    RigidTransform T_this_neighbour;
    std::string where;
  };
  std::map<std::string, std::vector<Neighbour>> neighbours_;
};

}  // namespace calib::formats
