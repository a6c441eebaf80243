#include <algorithm>
#include <map>

#include "extrinsic_formats/format_files.hpp"

namespace calib::formats {
namespace {

constexpr std::string_view program = "static_transform_publisher";

Eigen::Vector3d read_xyz(const ConfigNode& node) {
  return {node.at("x").number(-max_step_m, max_step_m), node.at("y").number(-max_step_m, max_step_m),
          node.at("z").number(-max_step_m, max_step_m)};
}

RigidTransform read_pose(const ConfigNode& node) {
  const Eigen::Vector3d t = read_xyz(node.at("translation"));
  const ConfigNode q = node.at("rotation");
  const auto T = make_transform({t.x(), t.y(), t.z()}, {q.at("x").number(-2, 2), q.at("y").number(-2, 2),
                                                        q.at("z").number(-2, 2), q.at("w").number(-2, 2)});
  if (!T) q.refuse(T.error().context);
  return *T;
}

/// geometry_msgs/TransformStamped, as `ros2 topic echo` writes it.
FrameEdge read_stamped(const ConfigNode& node, const std::string& file) {
  return {node.at("header").at("frame_id").text(), node.at("child_frame_id").text(), read_pose(node.at("transform")),
          file};
}

/// A file of YAML, or JSON, of one message or several between lines `---`.
Result<void> add_messages(const TextFile& file, Frames& frames) {
  std::string before;  // keeps the numbers of lines
  for (std::size_t at = 0; at < file.text.size();) {
    std::size_t end = at, next = file.text.size();
    while (end < file.text.size()) {
      const std::size_t line_end = std::min(file.text.find('\n', end), file.text.size());
      next = std::min(line_end + 1, file.text.size());
      if (words_of(file.text.substr(end, line_end - end)) == std::vector<std::string>{"---"}) break;
      end = next;
    }
    const std::string message = file.text.substr(at, end - at);
    if (!words_of(message).empty()) {
      const auto read = parse_yaml({file.name, before + message}, [&](const ConfigNode& node) {
        if (const auto transforms = node.find("transforms"))
          for (const ConfigNode& item : transforms->items()) frames.edges.push_back(read_stamped(item, file.name));
        else
          frames.edges.push_back(read_stamped(node, file.name));
      });
      if (!read) return read;
    }
    const auto lines = std::count(file.text.begin() + static_cast<std::ptrdiff_t>(at),
                                  file.text.begin() + static_cast<std::ptrdiff_t>(next), '\n');
    before.append(static_cast<std::size_t>(lines), '\n');
    at = std::max(next, end);
  }
  return {};
}

using Options = std::map<std::string, std::string, std::less<>>;

constexpr std::array<std::string_view, 3> xyz_options{"--x", "--y", "--z"}, rpy_options{"--roll", "--pitch", "--yaw"};
constexpr std::array<std::string_view, 4> xyzw_options{"--qx", "--qy", "--qz", "--qw"};
constexpr std::array<std::string_view, 2> frame_options{"--frame-id", "--child-frame-id"};

bool holds(const auto& options, std::string_view option) { return std::ranges::find(options, option) != options.end(); }

/// `--KEY VALUE` or `--KEY=VALUE`, each known and given once.
Result<Options> split_options(const TextFile& file, const std::vector<std::string>& words) {
  Options given;
  for (std::size_t i = 0; i < words.size(); ++i) {
    const std::string key = words[i].substr(0, words[i].find('='));
    if (!holds(xyz_options, key) && !holds(rpy_options, key) && !holds(xyzw_options, key) && !holds(frame_options, key))
      return malformed(file, key + ": is no option of " + std::string(program) + " that is known");
    const bool joined = key.size() < words[i].size();
    if (!joined && i + 1 == words.size()) return malformed(file, key + ": needs a value");
    std::string value = joined ? words[i].substr(key.size() + 1) : words[++i];
    if (!given.emplace(key, std::move(value)).second) return malformed(file, key + ": given twice");
  }
  for (const std::string_view key : frame_options)
    if (!given.contains(key)) return malformed(file, std::string(key) + ": missing; add it");
  return given;
}

/// The numbers of `keys`, each 0 where it is not given.
template <std::size_t N>
Result<std::array<double, N>> numbers_of(const TextFile& file, const Options& given,
                                         const std::array<std::string_view, N>& keys) {
  std::array<double, N> numbers{};
  for (std::size_t i = 0; i < N; ++i) {
    const auto found = given.find(keys[i]);
    if (found == given.end()) continue;
    const auto value = parse_number(found->second);
    if (!value || std::abs(*value) > max_step_m)
      return malformed(file, found->first + ": '" + found->second + "' is no number of at most 1e7");
    numbers[i] = *value;
  }
  return numbers;
}

/// The options --x ... --child-frame-id of ROS 2.
Result<FrameEdge> read_options(const TextFile& file, const std::vector<std::string>& words) {
  const auto given = split_options(file, words);
  if (!given) return propagate(given);
  const auto any = [&](const auto& keys) {
    return std::ranges::any_of(keys, [&](std::string_view key) { return given->contains(key); });
  };
  if (any(rpy_options) && any(xyzw_options))
    return malformed(file, "holds both roll, pitch, yaw and a quaternion; remove one");
  const auto t = numbers_of(file, *given, xyz_options);
  const auto rpy = numbers_of(file, *given, rpy_options);
  auto q = numbers_of(file, *given, xyzw_options);
  if (!t) return propagate(t);
  if (!rpy) return propagate(rpy);
  if (!q) return propagate(q);
  if (!given->contains("--qw")) (*q)[3] = 1;
  const Result<RigidTransform> T = any(xyzw_options)
                                       ? make_transform(*t, *q)
                                       : from_xyz_rpy(Eigen::Vector3d(t->data()), Eigen::Vector3d(rpy->data()));
  if (!T) return malformed(file, T.error().context);
  return FrameEdge{given->find("--frame-id")->second, given->find("--child-frame-id")->second, *T, file.name};
}

/// x y z yaw pitch roll PARENT CHILD, or x y z qx qy qz qw PARENT CHILD; ROS 1 ends with a period in ms.
Result<FrameEdge> read_positions(const TextFile& file, std::vector<std::string> words) {
  if (words.size() > 8 && parse_number(words.back())) words.pop_back();
  if (words.size() != 8 && words.size() != 9)
    return malformed(file, std::string(program) +
                               " needs x y z yaw pitch roll PARENT CHILD, or x y z qx qy qz qw PARENT "
                               "CHILD, or the options --x ... --child-frame-id");
  std::vector<double> values;
  for (std::size_t i = 0; i + 2 < words.size(); ++i) {
    const auto value = parse_number(words[i]);
    if (!value || std::abs(*value) > max_step_m)
      return malformed(file, "argument " + std::to_string(i + 1) + ": '" + words[i] + "' is no number of at most 1e7");
    values.push_back(*value);
  }
  Result<RigidTransform> T =
      values.size() == 7
          ? make_transform({values[0], values[1], values[2]}, {values[3], values[4], values[5], values[6]})
          : from_xyz_rpy({values[0], values[1], values[2]}, {values[5], values[4], values[3]});
  if (!T) return malformed(file, T.error().context);
  return FrameEdge{words[words.size() - 2], words.back(), *T, file.name};
}

/// Command lines that run static_transform_publisher, or one line of its options.
Result<void> add_commands(const TextFile& file, Frames& frames) {
  std::string text = file.text;
  for (std::size_t at = 0; (at = text.find("\\\n", at)) != std::string::npos;) text.replace(at, 2, "  ");
  std::erase_if(text, [](char c) { return c == '"' || c == '\''; });
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    std::vector<std::string> words = words_of(std::string_view(text).substr(at, end - at));
    at = end + 1;
    if (words.empty() || words.front().starts_with('#')) continue;
    const auto name = std::ranges::find_if(words, [](const std::string& word) { return word.ends_with(program); });
    if (name != words.end()) words.erase(words.begin(), name + 1);
    const bool options = std::ranges::any_of(words, [](const std::string& word) { return word.starts_with("--"); });
    const auto edge = options ? read_options(file, words) : read_positions(file, words);
    if (!edge) return propagate(edge);
    frames.edges.push_back(*edge);
  }
  return {};
}

std::string json_pose(const FrameEdge& pose) {
  const auto t = translation_m(pose.T_parent_child);
  const auto q = quaternion_xyzw(pose.T_parent_child);
  const auto n = number_text;
  return R"({"transforms": [{"header": {"frame_id": ")" + pose.parent + R"("}, "child_frame_id": ")" + pose.child +
         R"(", "transform": {"translation": {"x": )" + n(t[0]) + R"(, "y": )" + n(t[1]) + R"(, "z": )" + n(t[2]) +
         R"(}, "rotation": {"x": )" + n(q[0]) + R"(, "y": )" + n(q[1]) + R"(, "z": )" + n(q[2]) + R"(, "w": )" +
         n(q[3]) + "}}}]}\n";
}

}  // namespace

Result<Frames> read_tf(const std::vector<TextFile>& files) {
  Frames frames;
  for (const TextFile& file : files) {
    const bool commands =
        file.text.find(program) != std::string::npos || file.text.find("--frame-id") != std::string::npos;
    const auto added = commands ? add_commands(file, frames) : add_messages(file, frames);
    if (!added) return propagate(added);
  }
  return frames;
}

std::string tf_text(const FrameEdge& pose, TfForm form) {
  if (form == TfForm::json) return json_pose(pose);
  const auto t = translation_m(pose.T_parent_child);
  const auto q = quaternion_xyzw(pose.T_parent_child);
  if (form == TfForm::arguments)
    return "ros2 run tf2_ros static_transform_publisher --x " + number_text(t[0]) + " --y " + number_text(t[1]) +
           " --z " + number_text(t[2]) + " --qx " + number_text(q[0]) + " --qy " + number_text(q[1]) + " --qz " +
           number_text(q[2]) + " --qw " + number_text(q[3]) + " --frame-id " + pose.parent + " --child-frame-id " +
           pose.child + "\n";
  const auto field = [](const char* name, double value) {
    return "        " + std::string(name) + ": " + number_text(value) + "\n";
  };
  return "transforms:\n- header:\n    frame_id: " + pose.parent + "\n  child_frame_id: " + pose.child +
         "\n  transform:\n    translation:\n" + field("x", t[0]) + field("y", t[1]) + field("z", t[2]) +
         "    rotation:\n" + field("x", q[0]) + field("y", q[1]) + field("z", q[2]) + field("w", q[3]);
}

}  // namespace calib::formats
