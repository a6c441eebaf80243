#include <algorithm>
#include <iostream>
#include <set>

#include "calib/config_transform.hpp"
#include "commands.hpp"
#include "extrinsic_formats/frame_files.hpp"
#include "stored_records.hpp"

namespace calib::ctl {
namespace {

using formats::CameraAxes;

struct Source {
  RigidTransform T_camera_lidar;
  std::string words;  // where it is from
};

std::string listed(const std::set<std::string>& names) {
  std::string list;
  for (const std::string& name : names) list += (list.empty() ? "" : ", ") + name;
  return list;
}

/// The pair that is meant, of those that there are.
Result<std::string> choose_pair(const std::string& named, const std::set<std::string>& pairs,
                                const std::string& where) {
  if (named.empty() && pairs.size() == 1) return *pairs.begin();
  if (named.empty() && !pairs.empty())
    return fail(ErrorCode::bad_request, where + " has several pairs; name one: " + listed(pairs));
  if (!pairs.contains(named))
    return fail(ErrorCode::not_found,
                where + " has " + (pairs.empty() ? "no pair" : "no pair '" + named + "'; it has " + listed(pairs)));
  return named;
}

/// Of the last verified record that put an extrinsic of the pair in force, or of a given record.
Result<Source> from_records(const Paths& paths, const ExportOptions& options) {
  const auto chain = read_chain(paths);
  if (!chain) return propagate(chain);
  if (chain->broken) return tl::unexpected<Error>(*chain->broken);
  if (options.record) {
    if (*options.record > chain->verified.size())
      return fail(ErrorCode::record_not_found, "there is no record " + std::to_string(*options.record));
    const CalibrationRecord& record = chain->verified[*options.record - 1].record;
    return Source{record.T_camera_lidar, "record " + std::to_string(record.sequence) + " of pair " + record.pair +
                                             " (" + std::string(to_string(record.decision)) + "), verified"};
  }
  std::set<std::string> pairs;
  for (const auto& [record, bytes] : chain->verified) pairs.insert(record.pair);
  const auto pair = choose_pair(options.pair, pairs, "the store");
  if (!pair) return propagate(pair);
  for (auto link = chain->verified.rbegin(); link != chain->verified.rend(); ++link)
    if (link->record.pair == *pair && puts_in_force(link->record.decision))
      return Source{link->record.T_camera_lidar,
                    "record " + std::to_string(link->record.sequence) + " of pair " + *pair + ", verified, in force"};
  return fail(ErrorCode::record_not_found, "no record has put an extrinsic of pair " + *pair + " in force");
}

/// A configuration of calibd, or what `calibctl import` has written.
Result<Source> from_config(const ExportOptions& options) {
  const std::string file = options.config.string();
  const auto text = read_config_text(options.config);
  if (!text) return propagate(text);
  Source source{RigidTransform::Identity(), file};
  const auto read = [&](const ConfigNode& node) -> Result<void> {
    if (const auto lone = node.find("T_camera_lidar")) {
      source.T_camera_lidar = read_transform(*lone);
      return {};
    }
    std::set<std::string> names;
    for (const ConfigNode& pair : node.at("pairs").items()) names.insert(pair.at("name").text());
    const auto chosen = choose_pair(options.pair, names, file);
    if (!chosen) return propagate(chosen);
    for (const ConfigNode& pair : node.at("pairs").items())
      if (pair.at("name").text() == *chosen) source.T_camera_lidar = read_transform(pair.at("T_camera_lidar"));
    source.words += ", pair " + *chosen;
    return {};
  };
  Result<void> found;
  const auto parsed = parse_config_text(*text, options.config, [&](const ConfigNode& node) { found = read(node); });
  if (!parsed) return propagate(parsed);
  if (!found) return propagate(found);
  return source;
}

Result<std::string> written(const ExportOptions& options, const RigidTransform& T_camera_lidar) {
  const auto& facts = formats::facts_of(options.format);
  auto known = formats::load_frames(options.format, {}, options.with);
  if (!known) return propagate(known);
  formats::Extrinsic extrinsic{.T_camera_lidar = T_camera_lidar,
                               .camera = options.camera.empty() ? std::string(facts.camera) : options.camera,
                               .lidar = options.lidar.empty() ? std::string(facts.lidar) : options.lidar,
                               .parent = {},
                               .known = std::move(known->graph),
                               .tf_form = options.tf_form};
  extrinsic.parent = options.parent.empty() ? extrinsic.lidar : options.parent;
  for (const auto& [option, name] : {std::pair("--camera", extrinsic.camera), std::pair("--lidar", extrinsic.lidar),
                                     std::pair("--parent", extrinsic.parent)})
    if (!formats::is_frame_name(name))
      return fail(ErrorCode::bad_request, std::string(option) + ": '" + name +
                                              "' is no name of a frame: 1 .. 128 characters of A-Z a-z 0-9 _ / . -");
  if (extrinsic.camera == extrinsic.lidar)
    return fail(ErrorCode::bad_request, "--camera and --lidar name the same frame");
  if (!options.parent.empty() && !facts.is_tree)
    return fail(ErrorCode::bad_request, "--parent: the format " + std::string(facts.name) + " has no parent frame");
  const CameraAxes axes = options.axes.value_or(axes_of(facts, extrinsic.camera));
  if (axes == CameraAxes::body) extrinsic.T_camera_lidar = formats::T_optical_body().inverse() * T_camera_lidar;
  return formats::write_extrinsic(options.format, extrinsic);
}

}  // namespace

Exit export_extrinsic(const Paths& paths, const ExportOptions& options) {
  const auto source = options.config.empty() ? from_records(paths, options) : from_config(options);
  if (!source) return print_error(source.error());
  const auto text = written(options, source->T_camera_lidar);
  if (!text) return print_error(text.error());
  std::cout << *text << std::flush;
  std::cerr << "calibctl: exported from " << escape_control(source->words) << '\n';
  return Exit::done;
}

}  // namespace calib::ctl
