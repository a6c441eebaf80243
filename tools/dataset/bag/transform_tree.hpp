#pragma once

#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "calib/geometry.hpp"
#include "calib/result.hpp"
#include "ros2.h"

namespace calib {

/// The transforms between frames that a recording holds in /tf_static and /tf.
class TransformTree {
 public:
  enum class Topic { tf_static, tf };
  /// Names of frames are taken without a leading slash, as tf2 does. What is no transform is left out and remarked.
  void add(const tf2_msgs_msg_dds__TFMessage_& message, Topic topic);

  /// The transform of points of the frame `from` into the frame `to`. It is made of those of /tf_static and of those of
  /// /tf that never change. Fails with `calibration_missing`, and which frames there are.
  [[nodiscard]] Result<RigidTransform> find(const std::string& to, const std::string& from) const;
  /// The same of /tf_static alone: whether there is one.
  [[nodiscard]] bool connects(const std::string& to, const std::string& from) const;

  [[nodiscard]] const std::vector<std::string>& remarks() const { return remarks_; }

 private:
  static constexpr std::size_t most_frames = 4096;
  struct Edge {
    std::string parent;
    RigidTransform T_parent_child = RigidTransform::Identity();
    Topic topic = Topic::tf_static;
    bool changes = false;
  };
  using Edges = std::map<std::string, Edge, std::less<>>;  // by child
  struct Root {
    std::string frame;
    RigidTransform T_root_frame;
  };
  [[nodiscard]] const Edge* edge_above(const std::string& frame) const;
  [[nodiscard]] std::vector<std::string> chain(const std::string& frame) const;
  [[nodiscard]] std::string frames() const;
  void remark(std::string sentence);

  Edges edges_, moving_;  // of /tf_static, of /tf
  std::vector<std::string> remarks_;
};

/// A frame's name as it is compared and shown.
[[nodiscard]] std::string frame_name(const char* name);

}  // namespace calib
