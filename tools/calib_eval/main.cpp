#include <fmt/format.h>
#include <CLI/CLI.hpp>
#include <algorithm>
#include <charconv>
#include <cmath>
#include <functional>
#include <iostream>
#include <new>
#include <thread>

#include "calib_eval/commands.hpp"
#include "calib_eval/starts.hpp"
#include "dataset/bag_arguments.hpp"
#include "dataset/depth_files.hpp"

namespace calib::eval {
namespace {

/// A check for CLI11 from a parser that returns a `Result`.
template <typename Parser>
CLI::Validator parses(const Parser& parser, const std::string& what) {
  return CLI::Validator(
      [parser](std::string& text) {
        const auto parsed = parser(text);
        return parsed ? std::string() : parsed.error().context;
      },
      what);
}

std::string bounds(double least, double most, const char* between) {
  return fmt::format("{:g}{}{:g}", least, between, most);
}

std::optional<double> parse_number(const std::string& text) {
  char* end = nullptr;
  const double number = std::strtod(text.c_str(), &end);
  return text.empty() || *end != '\0' || !std::isfinite(number) ? std::nullopt : std::optional(number);
}

/// CLI11's own range has no objection to what is no number at all.
CLI::Validator number(double least, double most) {
  return CLI::Validator(
      [=](std::string& text) {
        const auto value = parse_number(text);
        return value && *value >= least && *value <= most
                   ? std::string()
                   : text + " is not a number from " + bounds(least, most, " to ");
      },
      bounds(least, most, ".."));
}

enum class Parity { any, odd };
/// CLI11 takes -1 for a large number where there is none below zero, and calls 1e3 out of range.
CLI::Validator whole_number(std::uint64_t least, std::uint64_t most, Parity parity = Parity::any) {
  const auto range = [=](const char* between) { return std::to_string(least) + between + std::to_string(most); };
  return CLI::Validator(
      [=](std::string& text) {
        std::uint64_t value = 0;
        const char* const end = text.data() + text.size();
        const bool whole = std::from_chars(text.data(), end, value) == std::from_chars_result{end, std::errc()};
        if (whole && value >= least && value <= most && (parity == Parity::any || value % 2 == 1)) return std::string();
        return text + (parity == Parity::odd ? " is not an odd number from " : " is not a whole number from ") +
               range(" to ");
      },
      range(".."));
}

std::vector<std::string> between_commas(const std::string& text) {
  std::vector<std::string> items;
  for (std::size_t begin = 0, end = 0; end != std::string::npos; begin = end + 1) {
    end = text.find(',', begin);
    items.push_back(text.substr(begin, end - begin));
  }
  return items;
}

/// `check` of each item of a list; CLI11's own delimiter has no objection to an item that is missing.
CLI::Validator each(const CLI::Validator& check) {
  return CLI::Validator(
      [check](std::string& text) {
        for (std::string& item : between_commas(text)) {
          if (item.empty()) return "'" + text + "' has a comma too many";
          if (std::string why = check(item); !why.empty()) return why;
        }
        return std::string();
      },
      check.get_description() + ",...");
}

/// What `parse` makes of each item of the lists, every value once.
template <typename Parse>
auto values_of(const std::vector<std::string>& lists, const Parse& parse) {
  std::vector<std::decay_t<decltype(*parse(std::string()))>> values;
  for (const std::string& list : lists)
    for (const std::string& item : between_commas(list))
      if (const auto value = *parse(item); std::ranges::find(values, value) == values.end()) values.push_back(value);
  return values;
}

/// Everything that the command line can say.
class CommandLine {
 public:
  CommandLine(int argc, char** argv);
  /// What is doubtful about the result.
  Result<Doubts> run() const { return command_(); }
  bool strict = false;
  CLI::App app{
      "How well an extrinsic is found on recorded frames, what its score looks like, and how soon drift is noticed",
      "calib-eval"};

 private:
  CLI::App* subcommand(const std::string& name, const std::string& what, std::function<Result<Doubts>()> run);
  void add_recording(CLI::App& to, bool or_simulation = false);
  void add_objectives(CLI::App& to);
  void add_calibrate();
  void add_landscape(const std::string& name, const std::string& what, bool of_pairs);
  void add_drift();
  void add_plot();
  void check_recording(const CLI::App& command) const;
  void finish_calibrate(const CLI::App& calibrate);
  void finish_drift(const CLI::App& drift);

  CommandWords words_;
  RecordingOptions recording_frames_;
  CalibrateOptions calibrate_;
  LandscapeOptions landscape_;
  DriftOptions drift_;
  std::vector<std::string> objectives_, axis_pairs_, knocks_, rotations_, translations_;
  bool simulated_ = false;
  std::filesystem::path plotted_, plots_;
  int degrees_of_freedom_ = 0;
  std::function<Result<Doubts>()> command_;
};

/// The words of the command without --threads, --strict and --json, which change nothing in the result.
CommandWords telling_words(int argc, char** argv) {
  CommandWords words{"calib-eval"};
  for (int i = 1; i < argc; ++i) {
    const std::string word = argv[i], name = word.substr(0, word.find('='));
    if (name == "--strict") continue;
    if (name != "--threads" && name != "--json")
      words.push_back(word);
    else if (name == word)
      ++i;
  }
  return words;
}

CommandLine::CommandLine(int argc, char** argv) : words_(telling_words(argc, argv)) {
  recording_frames_.threads = static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  app.require_subcommand(1);
  app.set_version_flag("--version", "calib-eval " CALIBD_VERSION);
  add_calibrate();
  add_landscape("curve", "Scores along each axis about the recording's extrinsic", false);
  add_landscape("surface", "Scores over pairs of axes about the recording's extrinsic", true);
  add_drift();
  add_plot();
}

CLI::App* CommandLine::subcommand(const std::string& name, const std::string& what,
                                  std::function<Result<Doubts>()> run) {
  CLI::App* const added = app.add_subcommand(name, what);
  added->callback([this, run = std::move(run)] { command_ = run; });
  return added;
}

void CommandLine::add_recording(CLI::App& to, bool or_simulation) {
  auto* const dataset = to.add_option("--dataset", recording_frames_.dataset, "Layout of the recording")
                            ->check(CLI::IsMember(std::vector<std::string>(datasets.begin(), datasets.end())));
  auto* const root =
      to.add_option("--root", recording_frames_.root,
                    "DATE/DRIVE of kitti-raw, root of kitti-360, kitti-object, nuscenes; rosbag2; YAML file of a list");
  add_bag_options(to, recording_frames_.bag);
  add_bag_depth_option(to, recording_frames_.bag);
  dataset->required(!or_simulation)->needs(root);
  root->required(!or_simulation)->needs(dataset);
  if (or_simulation) {
    auto* const sim = to.add_flag("--sim", simulated_, "Simulated streets instead of a recording")->excludes(dataset);
    to.add_option("--sim-places", recording_frames_.places, "Streets, of seeds from --seed on")
        ->needs(sim)
        ->check(whole_number(1, 1000))
        ->capture_default_str();
  }
  to.add_option("--drive", recording_frames_.drive, "Drive of kitti-360, scene of nuscenes (default: all)");
  to.add_option("--camera", recording_frames_.camera,
                "image_00 .. image_03, image_2, image_3, CAM_FRONT, ..., as the layout names them");
  to.add_option("--cloud-layout", recording_frames_.cloud_layout,
                "Numbers of a point in .bin clouds: float32x4 (as KITTI), float32x5 (as nuScenes), float64x4, ...")
      ->needs(dataset)
      ->check(parses(parse_cloud_layout, "LAYOUT"));
  auto* const source =
      to.add_option("--depth", recording_frames_.depth,
                    "Where depth comes from: stereo, onnx:DESCRIPTOR, topic (of rosbag2), true (of simulated streets)")
          ->check(CLI::Validator(
              [or_simulation](const std::string& text) {
                const bool known = text == "stereo" || text == "topic" || (or_simulation && text == "true") ||
                                   (text.starts_with("onnx:") && text.size() > 5);
                return known ? std::string() : text + " is none of stereo, onnx:DESCRIPTOR and topic";
              },
              "stereo|onnx:DESCRIPTOR|topic"));
  auto* const folder = to.add_option("--depth-dir", recording_frames_.depth_dir, "Depth from the files of this folder");
  auto* const kind = to.add_option("--depth-kind", recording_frames_.depth_kind, "disparity, inverse, depth or range")
                         ->check(parses(parse_depth_kind, "KIND"));
  folder->needs(kind)->excludes(source);
  kind->needs(folder);
  to.add_option("--depth-scale", recording_frames_.depth_scale, "What is stored divided by this is the value")
      ->needs(folder)
      ->check(number(1e-9, 1e9));
  to.add_flag("--monocular-depth", recording_frames_.monocular_files, "The depth in the files is of a single image");
  to.add_option("--depth-bias", recording_frames_.depth_bias,
                "Spoil the depth by a smooth random field of this amplitude")
      ->check(number(0, 0.99))
      ->capture_default_str();
  to.add_option("--seed", recording_frames_.seed, "Which field, and which orientations")
      ->check(whole_number(0, std::numeric_limits<std::uint64_t>::max()))
      ->capture_default_str();
  to.add_option("--frames", recording_frames_.frames, "So many, spread evenly over the recording")
      ->check(whole_number(RecordingFrames::fewest_frames, 10000))
      ->capture_default_str();
  to.add_option("--threads", recording_frames_.threads, "The result does not depend on it")
      ->check(whole_number(1, 1024))
      ->capture_default_str();
  to.add_flag("--strict", strict, "End with 4 when there is a reason for not believing the result");
}

void CommandLine::add_objectives(CLI::App& to) {
  to.add_option("--objective", objectives_, "default, d2d, i2i or i2i_nmi; several with commas")
      ->check(each(parses(parse_method, "NAME")));
  to.add_option("--dof", degrees_of_freedom_, "3: rotation only, 6: rotation and translation")
      ->check(CLI::IsMember({3, 6}));
}

void CommandLine::check_recording(const CLI::App& command) const {
  if (recording_frames_.depth.empty() && recording_frames_.depth_dir.empty())
    throw CLI::RequiredError("--depth or --depth-dir");
  if (recording_frames_.dataset == "kitti-360" && recording_frames_.drive.empty()) throw CLI::RequiredError("--drive");
  if (const auto fault = option_fault(recording_frames_)) throw CLI::ValidationError(fault->option, fault->why);
  if (const std::string given = given_bag_option(command); recording_frames_.dataset != "rosbag2" && !given.empty())
    throw CLI::ValidationError(given, "is for rosbag2");
}

void CommandLine::add_calibrate() {
  CLI::App* const added = subcommand("calibrate", "Searches from many wrong extrinsics, and how they end",
                                     [this] { return calibrate(recording_frames_, calibrate_, words_); });
  add_recording(*added);
  add_objectives(*added);
  const CLI::Validator range(
      [](std::string& text) {
        const auto degrees = parse_number(text);
        return degrees && ((*degrees >= 0 && *degrees <= 90) || *degrees == ErrorRange::any_orientation_deg)
                   ? std::string()
                   : text + " is neither within 0 .. 90 nor 180 (any orientation)";
      },
      "0..90|180");
  added->add_option("--rotation-deg", rotations_, "How far off starts are; several with commas")->check(each(range));
  added->add_option("--translation-cm", translations_, "Likewise, each with each rotation; for --dof 6")
      ->check(each(number(0, 1000)));
  added->add_option("--starts", calibrate_.starts, "Searches of each cell")
      ->check(whole_number(1, 100000))
      ->capture_default_str();
  auto* const json = added->add_option("--json", calibrate_.json, "Write the result into this file");
  added->add_option("--figures", calibrate_.figures, "Write overlays of one run of each cell into this folder")
      ->needs(json);
  added->parse_complete_callback([this, added] { finish_calibrate(*added); });
}

/// What is not given is as in the paper's tables.
void CommandLine::finish_calibrate(const CLI::App& calibrate) {
  check_recording(calibrate);
  calibrate_.degrees_of_freedom = degrees_of_freedom_ == 6 ? 6 : 3;
  const bool six = calibrate_.degrees_of_freedom == 6;
  if (!objectives_.empty()) calibrate_.methods = values_of(objectives_, parse_method);
  calibrate_.rotation_deg = values_of(rotations_, parse_number);
  calibrate_.translation_cm = values_of(translations_, parse_number);
  if (calibrate_.rotation_deg.empty())
    calibrate_.rotation_deg = six ? std::vector<double>{0.5, 1} : std::vector<double>{1, 2, 10, 20};
  if (calibrate_.translation_cm.empty())
    calibrate_.translation_cm = six ? std::vector<double>{25, 50} : std::vector<double>{0};
  if (!six && calibrate_.translation_cm != std::vector<double>{0})
    throw CLI::ValidationError("--translation-cm", "is for --dof 6");
}

void CommandLine::add_landscape(const std::string& name, const std::string& what, bool of_pairs) {
  CLI::App* const added = subcommand(name, what, [this, of_pairs] {
    return of_pairs ? surfaces(recording_frames_, landscape_, words_) : curves(recording_frames_, landscape_, words_);
  });
  add_recording(*added);
  add_objectives(*added);
  LookAround& around = landscape_.around;
  added->add_option("--range-deg", around.rotation_deg, "How far to either side")
      ->check(number(0.01, 180))
      ->capture_default_str();
  added->add_option("--range-cm", around.translation_cm, "How far to either side")
      ->check(number(0.1, 1000))
      ->capture_default_str();
  added->add_option("--points", around.points, "Scores from end to end of an axis, the one in the middle included")
      ->check(whole_number(3, 1001, Parity::odd))
      ->capture_default_str();
  auto* const json = added->add_option("--json", landscape_.json, "Write the result into this file");
  if (of_pairs) {
    json->required();
    added->add_option("--axes", axis_pairs_, "Pairs such as roll:pitch, several with commas")
        ->check(each(parses(parse_axis_pair, "AXIS:AXIS")));
  }
  added->parse_complete_callback([this, added] {
    check_recording(*added);
    landscape_.degrees_of_freedom = degrees_of_freedom_ == 3 ? 3 : 6;
    if (!objectives_.empty()) landscape_.methods = values_of(objectives_, parse_method);
    if (axis_pairs_.empty()) axis_pairs_ = {"roll:pitch", "roll:yaw", "pitch:yaw", "pitch:z", "yaw:y", "x:z"};
    landscape_.axis_pairs = values_of(axis_pairs_, parse_axis_pair);
  });
}

void CommandLine::add_drift() {
  CLI::App* const added = subcommand("drift", "Delays until drift is noticed, and the rate of false alarms",
                                     [this] { return drift(recording_frames_, drift_, words_); });
  add_recording(*added, true);
  added->get_option("--frames")->default_str(std::to_string(usual_drift_frames));
  auto* const knocks = added->add_option("--knock", knocks_, "How far LiDARs move, such as 0.25deg,10cm")
                           ->check(each(parses(parse_knock, "SIZE")));
  added->add_option("--rate", drift_.rate_deg_per_hour, "They creep instead, so many degrees per hour")
      ->excludes(knocks)
      ->check(number(0.001, 100));
  added->add_option("--pairs", drift_.pairs, "Given up so many pairs after the LiDAR has begun to move")
      ->check(whole_number(soonest_drifted_pairs, 100000));
  added->add_option("--seeds", drift_.sequences, "Sequences of each movement")
      ->check(whole_number(1, 100000))
      ->capture_default_str();
  added->add_option("--estimates", drift_.estimates, "Estimates of each movement")->check(whole_number(0, 1000));
  added->add_option("--weeks", drift_.weeks, "Vehicle-weeks of LiDARs that do not move")
      ->check(number(0.01, 1e6))
      ->capture_default_str();
  added->add_option("--period-s", recording_frames_.period_s, "Seconds between two pairs")
      ->check(number(0.01, 3600))
      ->capture_default_str();
  added->add_option("--driving-hours-per-week", drift_.driving_hours_per_week, "What makes a vehicle-week")
      ->check(number(0.01, 168))
      ->capture_default_str();
  added
      ->add_option("--false-alerts-per-1000-vehicle-weeks", drift_.false_alerts_per_1000_vehicle_weeks,
                   "What the monitor is set to")
      ->check(number(1e-6, 1e6))
      ->capture_default_str();
  added->add_option("--block", drift_.block, "Frames that stay together; default: the cube root of their number")
      ->check(whole_number(1, 10000));
  added->add_option("--json", drift_.json, "Write the result into this file");
  added->parse_complete_callback([this, added] { finish_drift(*added); });
}

void CommandLine::finish_drift(const CLI::App& drift) {
  if (drift.count("--frames") == 0) recording_frames_.frames = usual_drift_frames;
  if (simulated_) {
    recording_frames_.dataset = "sim";
    if (recording_frames_.depth.empty()) recording_frames_.depth = "stereo";
    if (!recording_frames_.depth_dir.empty()) throw CLI::ExcludesError("--depth-dir", "--sim");
    for (const char* name : {"--camera", "--drive"})
      if (drift.count(name) > 0) throw CLI::ExcludesError(name, "--sim");
  } else {
    if (recording_frames_.dataset.empty()) throw CLI::RequiredError("--dataset or --sim");
    if (recording_frames_.depth == "true") throw CLI::ValidationError("--depth", "true is for --sim");
    check_recording(drift);
  }
  if (knocks_.empty()) knocks_ = {"0.25deg", "0.5deg", "1deg", "10cm", "20cm"};
  drift_.knocks = values_of(knocks_, parse_knock);
}

void CommandLine::add_plot() {
  CLI::App* const added = subcommand("plot", "Draws a result, as PNG", [this]() -> Result<Doubts> {
    const auto drawn = plot(plotted_, plots_.empty() ? std::filesystem::path(plotted_).replace_extension() : plots_);
    return drawn ? Result<Doubts>() : propagate(drawn);
  });
  added->add_option("RESULT", plotted_, "What --json wrote")->required()->check(CLI::ExistingFile);
  added->add_option("--out", plots_, "Folder; default: RESULT without its extension");
}

}  // namespace
}  // namespace calib::eval

int main(int argc, char** argv) {
  calib::eval::CommandLine line(argc, argv);
  try {
    line.app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return line.app.exit(error) == 0 ? 0 : 2;
  }
  calib::Result<calib::eval::Doubts> done;
  try {
    done = line.run();
  } catch (const std::bad_alloc&) {
    done = calib::fail(calib::ErrorCode::out_of_memory,
                       "there is not enough memory; use fewer --frames, or fewer --threads");
  }
  if (done && !done->empty()) std::cout << "The result is not to be believed: " << calib::eval::codes_of(*done) << '\n';
  std::cout << std::flush;
  if (!done) std::cerr << "calib-eval: " << calib::escape_control(done.error().context) << '\n';
  // A full disk or a closed pipe must not look like success.
  if (!done || !std::cout) return 1;
  constexpr int doubtful = 4;  // as calibctl, which answers with it that the answer is no
  return line.strict && !done->empty() ? doubtful : 0;
}
