#include "extrinsic_formats/frame_graph.hpp"

#include <algorithm>
#include <deque>

namespace calib::formats {

Result<void> FrameGraph::add(FrameEdge edge) {
  if (edge.parent == edge.child)
    return fail(ErrorCode::calibration_malformed, edge.where + ": frame '" + edge.parent + "' is its own parent");
  auto& of_parent = neighbours_[edge.parent];
  const auto known = std::ranges::find(of_parent, edge.child, &Neighbour::frame);
  if (known != of_parent.end()) {
    if (known->T_this_neighbour.isApprox(edge.T_parent_child, 1e-9)) return {};
    return fail(ErrorCode::calibration_malformed, edge.where + ": '" + edge.child + "' has another pose in '" +
                                                      edge.parent + "' than in " + known->where);
  }
  of_parent.push_back({edge.child, edge.T_parent_child, edge.where});
  neighbours_[edge.child].push_back({edge.parent, edge.T_parent_child.inverse(), edge.where});
  return {};
}

Result<RigidTransform> FrameGraph::transform(const std::string& to, const std::string& from,
                                             std::string_view avoid) const {
  if (to == from) return RigidTransform::Identity();
  for (const std::string& frame : {to, from})
    if (!knows(frame)) return fail(ErrorCode::not_found, "there is no frame '" + frame + "'; there are: " + listed());
  std::map<std::string, RigidTransform> T_to{{to, RigidTransform::Identity()}};
  for (std::deque<std::string> waiting{to}; !waiting.empty(); waiting.pop_front()) {
    const RigidTransform T_to_here = T_to.at(waiting.front());
    if (waiting.front() == from) return T_to_here;
    for (const Neighbour& next : neighbours_.at(waiting.front()))
      if (next.frame != avoid && T_to.emplace(next.frame, T_to_here * next.T_this_neighbour).second)
        waiting.push_back(next.frame);
  }
  return fail(ErrorCode::not_found, "no chain of transforms leads from '" + from + "' to '" + to +
                                        "'; give the file that has the missing one with --with");
}

std::string FrameGraph::listed() const {
  constexpr int most = 20;
  std::string list;
  int count = 0;
  for (const auto& [frame, unused] : neighbours_) {
    if (++count > most) return list + ", ...";
    list += (list.empty() ? "" : ", ") + frame;
  }
  return list.empty() ? "none" : list;
}

}  // namespace calib::formats
