#include "dataset/bag/transform_tree.hpp"

#include <algorithm>
#include <set>
#include <span>

#include "calib/frame.hpp"

namespace calib {

std::string frame_name(const char* name) {
  std::string_view text = name != nullptr ? name : "";
  if (text.starts_with('/')) text.remove_prefix(1);
  return escape_control(text.substr(0, MessageNotes::longest_frame_id));
}

void TransformTree::remark(std::string sentence) {
  constexpr std::size_t most = 8;
  if (remarks_.size() < most && std::ranges::find(remarks_, sentence) == remarks_.end())
    remarks_.push_back(std::move(sentence));
}

void TransformTree::add(const tf2_msgs_msg_dds__TFMessage_& message, Topic topic) {
  Edges& edges = topic == Topic::tf_static ? edges_ : moving_;
  for (const auto& sent : std::span(message.transforms._buffer, message.transforms._length)) {
    const auto& [translation, rotation] = sent.transform;
    const std::string parent = frame_name(sent.header.frame_id), child = frame_name(sent.child_frame_id);
    const auto T_parent_child =
        make_transform({translation.x, translation.y, translation.z}, {rotation.x, rotation.y, rotation.z, rotation.w});
    if (!T_parent_child || parent == child || child.empty()) {
      remark("the transform from " + child + " to " + parent +
             " is left out: " + (T_parent_child ? "it is of one frame" : T_parent_child.error().context));
      continue;
    }
    const auto known = edges.find(child);
    if (known == edges.end()) {
      if (edges.size() < most_frames) edges.emplace(child, Edge{parent, *T_parent_child, topic, false});
      continue;
    }
    Edge& edge = known->second;
    const bool differs =
        edge.parent != parent || !edge.T_parent_child.matrix().isApprox(T_parent_child->matrix(), 1e-9);
    edge.changes = edge.changes || differs;
    if (differs && topic == Topic::tf_static) {
      remark("/tf_static has different transforms of " + child + ": the last one is used");
      edge = {parent, *T_parent_child, topic, true};
    }
  }
}

const TransformTree::Edge* TransformTree::edge_above(const std::string& frame) const {
  if (const auto found = edges_.find(frame); found != edges_.end()) return &found->second;
  const auto found = moving_.find(frame);
  return found == moving_.end() ? nullptr : &found->second;
}

/// The frame and those above it, up to the root of its tree.
std::vector<std::string> TransformTree::chain(const std::string& frame) const {
  std::vector<std::string> frames{frame};
  std::set<std::string> seen{frame};
  while (const Edge* edge = edge_above(frames.back())) {
    if (!seen.insert(edge->parent).second) break;  // a loop, which is no tree
    frames.push_back(edge->parent);
  }
  return frames;
}

std::string TransformTree::frames() const {
  std::set<std::string> names;
  for (const Edges* edges : {&edges_, &moving_})
    for (const auto& [child, edge] : *edges) names.insert({child, edge.parent});
  if (names.empty()) return "it has no transform at all";
  constexpr std::size_t most = 20;
  std::string text;
  std::size_t shown = 0;
  for (const std::string& name : names)
    if (shown++ < most) text += (text.empty() ? "" : ", ") + name;
  return "it has the frames " + text + (shown > most ? " and " + std::to_string(shown - most) + " more" : "");
}

bool TransformTree::connects(const std::string& to, const std::string& from) const {
  const auto a = chain(to), b = chain(from);
  return a.back() == b.back();
}

Result<RigidTransform> TransformTree::find(const std::string& to, const std::string& from) const {
  auto above_to = chain(to), above_from = chain(from);
  if (above_to.back() != above_from.back())
    return fail(ErrorCode::calibration_missing, "no transform from '" + from + "' to '" + to +
                                                    "' is in the recording's /tf_static or /tf; " + frames());
  // Above the nearest frame that both stand on, the two ways are one.
  while (above_to.size() > 1 && above_from.size() > 1 &&
         above_to[above_to.size() - 2] == above_from[above_from.size() - 2]) {
    above_to.pop_back();
    above_from.pop_back();
  }
  std::string changing;
  const auto along = [&](const std::vector<std::string>& frames) {
    RigidTransform T_top_frame = RigidTransform::Identity();
    for (std::size_t i = 0; i + 1 < frames.size(); ++i) {
      const Edge* edge = edge_above(frames[i]);
      if (edge->topic == Topic::tf && edge->changes) changing = "from '" + frames[i] + "' to '" + edge->parent + "'";
      T_top_frame = edge->T_parent_child * T_top_frame;
    }
    return T_top_frame;
  };
  const RigidTransform T_top_to = along(above_to), T_top_from = along(above_from);
  if (!changing.empty())
    return fail(ErrorCode::calibration_missing, "between '" + from + "' and '" + to + "' the transform " + changing +
                                                    " changes during the recording (/tf): LiDAR and camera are not "
                                                    "fixed to each other, or their frames are not those");
  return T_top_to.inverse() * T_top_from;
}

}  // namespace calib
