#include <iostream>
#include <nlohmann/json.hpp>

#include "calib/record.hpp"
#include "commands.hpp"
#include "extrinsic_formats/frame_files.hpp"
#include "extrinsic_formats/plausibility.hpp"
#include "text.hpp"

namespace calib::ctl {
namespace {

using formats::CameraAxes;

/// The frame that is meant: the named one, or the only one that can be, or the one that the format calls so.
Result<std::string> frame_of(const std::string& named, const std::optional<std::string>& only, std::string_view usual,
                             const char* option, const formats::LoadedFrames& loaded) {
  if (!named.empty()) return named;
  if (only) return *only;
  if (loaded.graph.knows(std::string(usual))) return std::string(usual);
  return fail(ErrorCode::bad_request,
              std::string("name the frame with ") + option + "; there are: " + loaded.graph.listed() + loaded.remark);
}

struct Imported {
  RigidTransform T;  // as the file has it
  formats::Reading reading;
  std::string camera, lidar;
};

Result<Imported> read_imported(const ImportOptions& options) {
  const auto& facts = formats::facts_of(options.format);
  const auto loaded = formats::load_frames(options.format, options.files, options.with);
  if (!loaded) return propagate(loaded);
  const auto camera = frame_of(options.camera, loaded->camera, facts.camera, "--camera", *loaded);
  if (!camera) return propagate(camera);
  const auto lidar = frame_of(options.lidar, loaded->lidar, facts.lidar, "--lidar", *loaded);
  if (!lidar) return propagate(lidar);
  if (*camera == *lidar) return fail(ErrorCode::bad_request, "--camera and --lidar name the same frame");
  const auto T = loaded->graph.transform(*camera, *lidar);
  if (!T) return fail(T.error().code, options.files.front().string() + ": " + T.error().context + loaded->remark);
  constexpr double most_m = 100;
  if (T->translation().norm() > most_m)
    return fail(ErrorCode::bad_transform, options.files.front().string() + ": '" + *camera + "' and '" + *lidar +
                                              "' are " + decimals(T->translation().norm(), 1) +
                                              " m apart, and at most 100 m are allowed; lengths are metres");
  return Imported{*T, {options.inverse, options.axes.value_or(axes_of(facts, *camera))}, *camera, *lidar};
}

std::string option_words(const formats::Reading& given, const formats::Reading& better) {
  std::string words;
  if (given.inverse != better.inverse) words = better.inverse ? "use --inverse" : "leave --inverse out";
  if (given.axes != better.axes)
    words += std::string(words.empty() ? "use" : ", and use") + " --camera-axes " +
             (better.axes == CameraAxes::body ? "body" : "optical");
  return words;
}

std::string yaml_list(std::initializer_list<double> values) {
  std::string list;
  for (const double value : values) list += (list.empty() ? "[" : ", ") + formats::number_text(value);
  return list + "]";
}

std::string snippet(const Imported& imported, const RigidTransform& T, const ImportOptions& options) {
  const auto t = translation_m(T);
  const auto q = quaternion_xyzw(T);
  return "# From " + escape_control(options.files.front().string()) + " (" +
         std::string(formats::facts_of(options.format).name) + "): points of " + escape_control(imported.lidar) +
         " into " + escape_control(imported.camera) +
         (imported.reading.axes == CameraAxes::body ? ", turned into optical axes" : "") +
         (imported.reading.inverse ? ", inverted" : "") +
         ".\nT_camera_lidar:\n  translation_m: " + yaml_list({t[0], t[1], t[2]}) +
         "\n  quaternion_xyzw: " + yaml_list({q[0], q[1], q[2], q[3]}) + "\n";
}

}  // namespace

CameraAxes axes_of(const formats::FormatFacts& facts, std::string_view camera_frame) {
  return camera_frame.find("optical") == std::string_view::npos ? facts.axes : CameraAxes::optical;
}

Exit import_extrinsic(const ImportOptions& options) {
  const auto imported = read_imported(options);
  if (!imported) return print_error(imported.error());
  if (const auto doubt = options.check ? formats::doubt_about(imported->T, imported->reading) : std::nullopt) {
    print_error({ErrorCode::extrinsic_implausible,
                 options.files.front().string() + ": the transform from '" + imported->lidar + "' to '" +
                     imported->camera + "' is no plausible T_camera_lidar: " + doubt->words +
                     (doubt->better ? ": " + option_words(imported->reading, *doubt->better) : "") +
                     "; or --no-check, if the sensors are mounted so"});
    return Exit::no;
  }
  const RigidTransform T = formats::read_as(imported->T, imported->reading);
  std::cout << (options.json ? json_text(transform_json(T), 2) : snippet(*imported, T, options));
  return Exit::done;
}

}  // namespace calib::ctl
