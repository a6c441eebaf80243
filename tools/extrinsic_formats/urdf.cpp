#include <tinyxml2.h>

#include <algorithm>

#include "extrinsic_formats/format_files.hpp"

namespace calib::formats {
namespace {

using tinyxml2::XMLElement;

std::string named(const XMLElement& element) {
  const char* const name = element.Attribute("name");
  return "joint '" + std::string(name ? name : "") + "' (line " + std::to_string(element.GetLineNum()) + ")";
}

/// Three numbers of an attribute; zeros where there is none.
Result<Eigen::Vector3d> three(const TextFile& file, const XMLElement& joint, const XMLElement* origin, const char* key,
                              double bound) {
  const char* const text = origin ? origin->Attribute(key) : nullptr;
  if (!text) return Eigen::Vector3d::Zero().eval();
  if (std::string_view(text).find("${") != std::string_view::npos)
    return malformed(file, named(joint) + ": " + key + ": is not expanded; run xacro first");
  const auto words = words_of(text);
  if (words.size() != 3) return malformed(file, named(joint) + ": " + key + ": needs three numbers");
  Eigen::Vector3d values;
  for (int i = 0; i < 3; ++i) {
    const auto value = parse_number(words[static_cast<std::size_t>(i)]);
    if (!value)
      return malformed(file, named(joint) + ": " + key + ": '" + words[static_cast<std::size_t>(i)] + "' is no number");
    if (std::abs(*value) > bound)
      return malformed(file,
                       named(joint) + ": " + key + ": " + number_text(*value) + " is beyond " + number_text(bound));
    values[i] = *value;
  }
  return values;
}

Result<FrameEdge> read_joint(const TextFile& file, const XMLElement& joint) {
  const auto link = [&](const char* key) -> Result<std::string> {
    const XMLElement* const element = joint.FirstChildElement(key);
    const char* const name = element ? element->Attribute("link") : nullptr;
    if (!name || *name == '\0') return malformed(file, named(joint) + ": " + key + ": names no link");
    return std::string(name);
  };
  const auto parent = link("parent"), child = link("child");
  if (!parent) return propagate(parent);
  if (!child) return propagate(child);
  const XMLElement* const origin = joint.FirstChildElement("origin");
  if (origin && origin->NextSiblingElement("origin")) return malformed(file, named(joint) + ": origin: given twice");
  const auto xyz = three(file, joint, origin, "xyz", max_step_m), rpy = three(file, joint, origin, "rpy", 10);
  if (!xyz) return propagate(xyz);
  if (!rpy) return propagate(rpy);
  return FrameEdge{*parent, *child, from_xyz_rpy(*xyz, *rpy), file.name};
}

}  // namespace

Result<Frames> read_urdf(const std::vector<TextFile>& files) {
  Frames frames;
  for (const TextFile& file : files) {
    tinyxml2::XMLDocument document;
    if (document.Parse(file.text.data(), file.text.size()) != tinyxml2::XML_SUCCESS)
      return malformed(file, "line " + std::to_string(document.ErrorLineNum()) + ": is not XML");
    const XMLElement* const robot = document.FirstChildElement("robot");
    if (!robot) return malformed(file, "holds no element robot; it is no URDF");
    for (auto* joint = robot->FirstChildElement("joint"); joint; joint = joint->NextSiblingElement("joint")) {
      // Where other joints stand is no calibration: a chain must not lead through them.
      const char* const type = joint->Attribute("type");
      if (!type) return malformed(file, named(*joint) + ": type: missing");
      if (std::string_view(type) != "fixed") {
        frames.remark = "; joints that are not fixed are left out";
        continue;
      }
      auto edge = read_joint(file, *joint);
      if (!edge) return propagate(edge);
      frames.edges.push_back(*std::move(edge));
    }
  }
  return frames;
}

std::string urdf_text(const FrameEdge& pose) {
  const Eigen::Vector3d t = pose.T_parent_child.translation(), rpy = roll_pitch_yaw_rad(pose.T_parent_child.linear());
  const auto listed = [](const Eigen::Vector3d& v) {
    return number_text(v.x()) + " " + number_text(v.y()) + " " + number_text(v.z());
  };
  std::string name = pose.child;
  std::ranges::replace(name, '/', '_');
  return "<robot name=\"extrinsic\">\n  <link name=\"" + pose.parent + "\"/>\n  <link name=\"" + pose.child +
         "\"/>\n  <joint name=\"" + name + "_joint\" type=\"fixed\">\n    <parent link=\"" + pose.parent +
         "\"/>\n    <child link=\"" + pose.child + "\"/>\n    <origin xyz=\"" + listed(t) + "\" rpy=\"" + listed(rpy) +
         "\"/>\n  </joint>\n</robot>\n";
}

}  // namespace calib::formats
