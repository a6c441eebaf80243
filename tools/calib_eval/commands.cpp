#include "calib_eval/commands.hpp"

#include <fmt/format.h>

#include <unistd.h>

#include <cerrno>
#include <iostream>

#include "calib/file.hpp"
#include "calib_eval/progress.hpp"
#include "calib_eval/report.hpp"

namespace calib::eval {
namespace {

std::vector<Cell> cells_of(const CalibrateOptions& options, bool monocular_depth) {
  std::vector<Cell> cells;
  for (const Method method : options.methods)
    for (const double rotation : options.rotation_deg)
      for (const double translation : options.translation_cm)
        cells.push_back({method, options.degrees_of_freedom, {rotation, translation}, monocular_depth});
  return cells;
}

std::string name_of(const Cell& cell) {
  return fmt::format("{}, {:g} deg, {:g} cm", to_string(cell.method), cell.range.rotation_deg,
                     cell.range.translation_cm);
}

/// What is looked at: features are made once, for all objectives.
struct Landscape {
  RecordingFrames recording_frames;
  std::vector<FeatureSet> features;
};
Result<Landscape> look(const RecordingOptions& recording_options, const LandscapeOptions& options) {
  auto recording_frames = read_recording_frames(recording_options);
  if (!recording_frames) return propagate(recording_frames);
  bool baselines = false;
  for (const Method method : options.methods) baselines |= needs_baseline_features(method);
  auto features = recording_frames->features({.bounds = options.around.bounds(), .baselines = baselines},
                                             recording_options.threads);
  if (!features) return propagate(features);
  return Landscape{*std::move(recording_frames), *std::move(features)};
}

std::array<bool, 6> free_axes(int degrees_of_freedom) { return Cell{{}, degrees_of_freedom, {}}.free_axes(); }

/// Made before hours of work, and found out then whether it can be written into.
Result<void> make_folder(const std::filesystem::path& folder) {
  if (is_foreign_link(folder))
    return fail(ErrorCode::write_failed, folder.string() + " is a link that another user has made");
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (!error && access(folder.c_str(), W_OK | X_OK) != 0) error.assign(errno, std::generic_category());
  if (!error) return {};
  return fail(ErrorCode::write_failed, "figures cannot be written into " + folder.string() + ": " + error.message());
}

/// What is doubtful about the frames, as it stands in every result.
Doubts begin_doubts(Json& result, const RecordingFrames& recording_frames) {
  Doubts doubts = doubts_of(recording_frames);
  result["doubts"] = to_json(doubts);
  return doubts;
}

std::string frames_line(const RecordingFrames& recording_frames) {
  return std::to_string(recording_frames.frames.size()) + " frames, vector instructions " +
         std::string(vector_instructions());
}

}  // namespace

Result<RecordingFrames> read_recording_frames(const RecordingOptions& options) {
  auto recording_frames = RecordingFrames::read(options);
  if (!recording_frames) return recording_frames;
  for (const auto& lines : {recording_frames->remarks, recording_frames->left_out})
    for (const std::string& line : lines) std::cerr << "calib-eval: " << escape_control(line) << '\n';
  return recording_frames;
}

void print_doubts(const Doubts& doubts) {
  for (const Doubt& one : doubts)
    std::cout << "  " << escape_control(one.words) << " [" << one.code << "]" << std::endl;
}

Result<Doubts> calibrate(const RecordingOptions& recording_options, const CalibrateOptions& options,
                         const CommandWords& words) {
  const auto file = ResultFile::at(options.json);
  if (!file) return propagate(file);
  if (!options.figures.empty())
    if (auto made = make_folder(options.figures); !made) return propagate(made);
  const auto recording_frames = read_recording_frames(recording_options);
  if (!recording_frames) return propagate(recording_frames);
  Json result = describe("calibrate", words, recording_options, *recording_frames);
  Doubts doubts = begin_doubts(result, *recording_frames);
  result["cells"] = Json::array();
  result["runs"] = Json::array();
  if (!options.figures.empty()) result["figures"] = Json::array();
  std::cout << frames_line(*recording_frames) << ", " << options.starts << " starts\n";
  print_doubts(doubts);
  std::cout << table_heading() << std::endl;
  const std::vector<Cell> cells = cells_of(options, recording_options.monocular_depth());
  for (std::size_t i = 0; i < cells.size(); ++i) {
    const auto experiment = [&] {
      Progress progress(name_of(cells[i]), static_cast<std::size_t>(options.starts));
      return conduct(*recording_frames, cells[i],
                     {options.starts, recording_options.seed, recording_options.threads, [&] { progress.step(); }});
    }();
    if (!experiment) return propagate(experiment);
    std::cout << table_line(*experiment) << std::endl;
    const Doubts of_cell = doubts_of(*experiment, *recording_frames);
    print_doubts(of_cell);
    doubts.insert(doubts.end(), of_cell.begin(), of_cell.end());
    result["cells"].push_back(to_json(*experiment));
    result["cells"].back()["doubts"] = to_json(of_cell);
    for (Json& run : runs_to_json(*experiment, i)) result["runs"].push_back(std::move(run));
    if (!options.figures.empty()) {
      const auto figure = draw(*recording_frames, *experiment, options.figures);
      if (!figure) return propagate(figure);
      if (*figure) result["figures"].push_back(to_json(**figure, i, absolute(options.json).parent_path()));
    }
    // After each cell: what is done is kept.
    if (auto written = file->write(result, i + 1 == cells.size()); !written) return propagate(written);
  }
  return doubts;
}

Result<Doubts> curves(const RecordingOptions& recording_options, const LandscapeOptions& options,
                      const CommandWords& words) {
  const auto file = ResultFile::at(options.json);
  if (!file) return propagate(file);
  const auto seen = look(recording_options, options);
  if (!seen) return propagate(seen);
  const auto& [recording_frames, features] = *seen;
  const auto frames = pointers(features);
  Json result = describe("curve", words, recording_options, recording_frames);
  const Doubts doubts = begin_doubts(result, recording_frames);
  result["curves"] = Json::array();
  std::cout << frames_line(recording_frames) << '\n';
  print_doubts(doubts);
  for (const Method method : options.methods) {
    const Objective objective =
        final_objective(method, free_axes(options.degrees_of_freedom), recording_options.monocular_depth());
    std::cout << to_string(method) << " scores best at";
    for (int axis = 0; axis < 6; ++axis) {
      const Curve along =
          curve(frames, recording_frames.T_camera_lidar, objective, axis, options.around, recording_options.threads);
      std::cout << (axis == 0 ? " " : ", ") << axis_names[axis] << ' ' << along.maximum_at() << ' ' << unit_of(axis);
      result["curves"].push_back(to_json(along, method, options.degrees_of_freedom));
    }
    std::cout << " (steps of " << options.around.step(0) << " deg, " << options.around.step(3) << " cm)" << std::endl;
  }
  if (auto written = file->write(result, true); !written) return propagate(written);
  return doubts;
}

Result<Doubts> surfaces(const RecordingOptions& recording_options, const LandscapeOptions& options,
                        const CommandWords& words) {
  const auto file = ResultFile::at(options.json);
  if (!file) return propagate(file);
  const auto seen = look(recording_options, options);
  if (!seen) return propagate(seen);
  const auto& [recording_frames, features] = *seen;
  const auto frames = pointers(features);
  Json result = describe("surface", words, recording_options, recording_frames);
  const Doubts doubts = begin_doubts(result, recording_frames);
  result["surfaces"] = Json::array();
  print_doubts(doubts);
  Progress progress("surfaces", options.methods.size() * options.axis_pairs.size());
  for (const Method method : options.methods) {
    const Objective objective =
        final_objective(method, free_axes(options.degrees_of_freedom), recording_options.monocular_depth());
    for (const auto& axes : options.axis_pairs) {
      const Surface over =
          surface(frames, recording_frames.T_camera_lidar, objective, axes, options.around, recording_options.threads);
      result["surfaces"].push_back(to_json(over, method, options.degrees_of_freedom));
      progress.step();
    }
  }
  if (auto written = file->write(result, true); !written) return propagate(written);
  return doubts;
}

Result<void> plot(const std::filesystem::path& result, const std::filesystem::path& folder) {
  constexpr std::uintmax_t most_bytes = 1 << 30;
  std::error_code error;
  if (!std::filesystem::is_regular_file(result, error) || std::filesystem::file_size(result, error) > most_bytes)
    return fail(ErrorCode::result_unreadable, result.string() + " is no regular file of up to 1 GiB");
  if (is_foreign_link(folder))
    return fail(ErrorCode::write_failed, folder.string() + " is a link that another user has made");
  const auto program = std::filesystem::read_symlink("/proc/self/exe", error);
  // As installed, and as in a build folder.
  const auto script = program.parent_path().parent_path() / "share" / "calibd" / "calib-eval-plot";
  execl(script.c_str(), script.c_str(), "--out", folder.c_str(), "--", result.c_str(), static_cast<char*>(nullptr));
  return fail(ErrorCode::plot_missing, script.string() + " cannot be run: calib-eval is not installed as a whole");
}

}  // namespace calib::eval
