#include "calib_eval/report.hpp"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <system_error>

#include "calib/file.hpp"

namespace calib::eval {
namespace {

namespace fs = std::filesystem;

Json to_json(const Vector6& values) { return std::vector<double>(values.data(), values.data() + 6); }

template <typename T>
Json or_null(const std::optional<T>& value) {
  if (!value) return nullptr;
  if constexpr (std::is_same_v<T, Vector6>)
    return to_json(*value);
  else
    return *value;
}

Json to_json(const RigidTransform& transform) {
  return {{"translation_m", translation_m(transform)}, {"quaternion_xyzw", quaternion_xyzw(transform)}};
}

Json to_json(const Camera& camera) {
  return {{"model", to_string(camera.model())},
          {"size", {camera.width(), camera.height()}},
          {"intrinsics", {camera.fx(), camera.fy(), camera.cx(), camera.cy()}},
          {"distortion", camera.distortion()}};
}

Json describe_depth(const RecordingOptions& options) {
  Json depth;
  if (options.depth.empty()) {
    depth = {{"source", "files"}, {"folder", options.depth_dir.string()}, {"kind", options.depth_kind}};
    if (options.depth_scale) depth["scale"] = *options.depth_scale;
  } else {
    depth = {{"source", options.depth}};
  }
  depth["bias"] = options.depth_bias;
  return depth;
}

Json to_json(const std::optional<RecordingAgreement>& agreement) {
  if (!agreement) return nullptr;
  return {{"rank_correlation", agreement->rank_correlation},
          {"points", agreement->points},
          {"frames", agreement->frames},
          {"own_cloud_better", agreement->own_cloud_better}};
}

Json describe_cell(const Cell& cell) {
  return {{"objective", to_string(cell.method)},
          {"dof", cell.degrees_of_freedom},
          {"rotation_deg", cell.range.rotation_deg},
          {"translation_cm", cell.range.translation_cm}};
}

Json best_to_json(const Experiment& experiment) {
  if (!experiment.best) return nullptr;
  const Run& run = experiment.runs[experiment.best->run];
  const Uncertainty& uncertainty = experiment.best->uncertainty;
  // Of the axes that were searched; of the others nothing is known.
  const auto searched = [free_axes = experiment.cell.free_axes()](Json of_axes) {
    for (std::size_t axis = 0; axis < free_axes.size(); ++axis)
      if (!free_axes[axis]) of_axes[axis] = nullptr;
    return of_axes;
  };
  const auto sigma = [&](const Matrix6& covariance) {
    return searched(to_json(in_degrees_and_cm(covariance.diagonal().cwiseMax(0).cwiseSqrt())));
  };
  return {{"run", experiment.best->run},
          {"score", run.result->score_after},
          {"T_camera_lidar", to_json(run.result->T_camera_lidar)},
          {"sigma_by_curvature", sigma(uncertainty.covariance)},
          {"sigma_by_bootstrap", sigma(uncertainty.bootstrap_covariance)},
          {"observable", searched(uncertainty.observable)}};
}

std::string text(fmt::format_string<const double&> format, const std::optional<double>& value) {
  return value ? fmt::format(format, *value) : "-";
}

std::string columns(const std::array<std::string, 9>& cells) {
  constexpr std::array widths{9, 3, 8, 11, 6, 14, 17, 11, 9};
  std::string line;
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const std::string padding(std::max(0, widths[i] - static_cast<int>(cells[i].size())), ' ');
    line += i == 0 ? cells[i] + padding : "  " + padding + cells[i];
  }
  return line;
}

tl::unexpected<Error> write_failed(const fs::path& file, const std::string& why = "") {
  return fail(ErrorCode::write_failed, file.string() + " cannot be written" + why);
}

}  // namespace

Json describe(const char* kind, const std::vector<std::string>& command, const RecordingOptions& options,
              const RecordingFrames& recording_frames) {
  std::vector<std::string> names;
  for (const RecordingFrames::Frame& frame : recording_frames.frames) names.push_back(frame.name);
  return {{"schema", 1},
          {"kind", kind},
          {"complete", false},
          {"version", CALIBD_VERSION},
          {"command", command},
          {"vector_instructions", vector_instructions()},
          {"recording",
           {{"dataset", options.dataset},
            {"root", options.root.string()},
            {"drive", options.drive},
            {"camera", to_json(recording_frames.camera)},
            {"T_camera_lidar", to_json(recording_frames.T_camera_lidar)},
            {"depth", describe_depth(options)},
            {"depth_agreement", to_json(recording_frames.agreement)},
            {"frames", names},
            {"left_out", recording_frames.left_out}}},
          {"seed", options.seed}};
}

Json to_json(const Experiment& experiment) {
  const Summary summary = summarise(experiment.runs);
  Json json = describe_cell(experiment.cell);
  json["starts"] = summary.starts;
  json["hits"] = summary.hits;
  json["hit_rate"] = summary.starts > 0 ? static_cast<double>(summary.hits) / summary.starts : 0;
  json["failures"] = summary.failures;
  json["hit_rotation_error_deg"] = or_null(summary.hit_rotation_error_deg);
  json["hit_translation_error_cm"] = or_null(summary.hit_translation_error_cm);
  json["mean"] = or_null(summary.of_hits.mean);
  json["std"] = or_null(summary.of_hits.standard_deviation);
  json["all_mean"] = or_null(summary.of_all.mean);
  json["all_std"] = or_null(summary.of_all.standard_deviation);
  json["evaluations"] = or_null(summary.evaluations);
  json["seconds_per_run"] = or_null(summary.seconds_per_run);
  json["best"] = best_to_json(experiment);
  return json;
}

Json to_json(const Doubts& doubts) {
  Json json = Json::array();
  for (const Doubt& one : doubts) json.push_back({{"code", one.code}, {"words", one.words}});
  return json;
}

Json runs_to_json(const Experiment& experiment, std::size_t cell) {
  Json runs = Json::array();
  for (std::size_t i = 0; i < experiment.runs.size(); ++i) {
    const Run& run = experiment.runs[i];
    Json json{{"cell", cell}};
    json.update(describe_cell(experiment.cell));
    json["run"] = i;
    json["start"] = to_json(in_degrees_and_cm(perturbation_parameters(run.start)));
    json["hit"] = run.hit();
    if (run.result) {
      json["end"] = to_json(in_degrees_and_cm(perturbation_parameters(run.end)));
      json["rotation_error_deg"] = run.rotation_error_rad() / radians_per_degree;
      json["translation_error_cm"] = run.translation_error_m() * 100;
      json["score_before"] = run.result->score_before;
      json["score_after"] = run.result->score_after;
      json["depth_is_biased"] = run.result->depth_is_biased;
      json["evaluations"] = run.result->evaluations;
      json["ends_at_limit"] = run.result->ends_at_limit;
      json["reason"] = run.result->reason;
      json["seconds"] = run.seconds;
    } else {
      json["end"] = nullptr;
      json["reason"] = run.result.error().context;
    }
    runs.push_back(std::move(json));
  }
  return runs;
}

Json to_json(const Figure& figure, std::size_t cell, const fs::path& base) {
  Json views = Json::array();
  for (const Figure::View& view : figure.views)
    views.push_back({{"view", view.name},
                     {"score", view.score},
                     {"overlay", fs::proximate(view.overlay, base).string()},
                     {"histogram", view.histogram.counts}});
  return {{"cell", cell},
          {"run", figure.run},
          {"frame", figure.frame},
          {"features", figure.features == Features::depth ? "depth" : "intensity"},
          {"classes", JointHistogram::classes},
          {"views", std::move(views)}};
}

Json to_json(const Curve& curve, Method method, int degrees_of_freedom) {
  return {{"objective", to_string(method)}, {"dof", degrees_of_freedom}, {"axis", axis_names[curve.axis]},
          {"unit", unit_of(curve.axis)},    {"offset", curve.offsets},   {"score", curve.scores}};
}

Json to_json(const Surface& surface, Method method, int degrees_of_freedom) {
  Json rows = Json::array();
  const std::size_t columns = surface.offsets[1].size();
  for (std::size_t i = 0; i < surface.offsets[0].size(); ++i)
    rows.push_back(std::vector<double>(surface.scores.begin() + static_cast<std::ptrdiff_t>(i * columns),
                                       surface.scores.begin() + static_cast<std::ptrdiff_t>((i + 1) * columns)));
  return {{"objective", to_string(method)},
          {"dof", degrees_of_freedom},
          {"axes", {axis_names[surface.axes[0]], axis_names[surface.axes[1]]}},
          {"units", {unit_of(surface.axes[0]), unit_of(surface.axes[1])}},
          {"offset", surface.offsets},
          {"score", std::move(rows)}};
}

std::string table_heading() {
  return columns({"objective", "dof", "rotation", "translation", "hits", "rotation error", "translation error",
                  "evaluations", "s per run"});
}

std::string table_line(const Experiment& experiment) {
  const Cell& cell = experiment.cell;
  const Summary summary = summarise(experiment.runs);
  const bool six = cell.degrees_of_freedom == 6;
  return columns({std::string(to_string(cell.method)), std::to_string(cell.degrees_of_freedom),
                  cell.range.any_orientation() ? "any" : text("{:g} deg", cell.range.rotation_deg),
                  six ? text("{:g} cm", cell.range.translation_cm) : "-",
                  text("{:.1f} %", summary.starts > 0 ? 100.0 * summary.hits / summary.starts : 0),
                  text("{:.3f} deg", summary.hit_rotation_error_deg),
                  six ? text("{:.2f} cm", summary.hit_translation_error_cm) : "-", text("{:.0f}", summary.evaluations),
                  text("{:.3f}", summary.seconds_per_run)});
}

Result<ResultFile> ResultFile::at(const fs::path& file) {
  ResultFile result;
  result.named_ = result.file_ = file;
  if (file.empty()) return result;
  std::error_code error;
  const fs::file_type type = fs::status(file, error).type();
  if (type == fs::file_type::directory) return write_failed(file, ": it is a folder");
  result.replaced_ = type == fs::file_type::regular || type == fs::file_type::not_found;
  if (!result.replaced_) return result;
  // Not canonical(), as what a link points to need not be there yet.
  for (int links = 0; links < 40 && fs::is_symlink(fs::symlink_status(result.file_, error)); ++links) {
    if (is_foreign_link(result.file_))
      return write_failed(file, ": " + result.file_.string() + " is a link that another user has made");
    result.file_ = result.file_.parent_path() / fs::read_symlink(result.file_, error);
  }
  const fs::path trial = result.file_.string() + ".trial";
  if (!replace_file(trial, "")) return write_failed(file);
  fs::remove(trial, error);
  return result;
}

Result<void> ResultFile::write(Json& json, bool complete) const {
  json["complete"] = complete;
  if (file_.empty() || (!replaced_ && !complete)) return {};
  // Names may hold any bytes that a file system allows.
  const std::string text = json.dump(1, ' ', false, Json::error_handler_t::replace) + '\n';
  if (replaced_) return replace_file(file_, text);
  std::ofstream out(file_);
  out << text << std::flush;
  return out ? Result<void>() : write_failed(named_);
}

}  // namespace calib::eval
