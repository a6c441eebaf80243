#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "calib_eval/doubts.hpp"
#include "calib_eval/landscape.hpp"
#include "calib_eval/recording_frames.hpp"

namespace calib::eval {

/// What a command says about itself in its result: its words without those that change nothing in it.
using CommandWords = std::vector<std::string>;

/// As `RecordingFrames::read`, with a line on standard error for all there is to remark.
[[nodiscard]] Result<RecordingFrames> read_recording_frames(const RecordingOptions& options);

struct CalibrateOptions {
  std::vector<Method> methods{Method::standard};
  int degrees_of_freedom = 3;
  std::vector<double> rotation_deg, translation_cm;  // every one with every other
  int starts = 200;
  std::filesystem::path json, figures;  // empty: not wanted
};
/// Runs every cell, with a line of the table for each. As the other commands that compute, it returns what is doubtful
/// about the result, which is also among its text and in its JSON.
[[nodiscard]] Result<Doubts> calibrate(const RecordingOptions& recording_frames, const CalibrateOptions& options,
                                       const CommandWords& words);
/// Lines of standard output.
void print_doubts(const Doubts& doubts);

struct LandscapeOptions {
  std::vector<Method> methods{Method::standard};
  int degrees_of_freedom = 6;
  LookAround around;
  std::vector<std::array<int, 2>> axis_pairs;  // for surfaces
  std::filesystem::path json;
};
/// Scores along each axis, with where they are best.
[[nodiscard]] Result<Doubts> curves(const RecordingOptions& recording_frames, const LandscapeOptions& options,
                                    const CommandWords& words);
/// Scores over pairs of axes.
[[nodiscard]] Result<Doubts> surfaces(const RecordingOptions& recording_frames, const LandscapeOptions& options,
                                      const CommandWords& words);

/// How far a LiDAR is knocked: rad about an axis, or m along it. To either side.
struct KnockSize {
  bool rotation = true;
  double size = 0;

  bool operator==(const KnockSize&) const = default;
};
/// "0.25deg", "10cm": more than nothing, and no more than 5 degrees or 50 cm. Fails with `bad_knock`.
[[nodiscard]] Result<KnockSize> parse_knock(const std::string& text);

/// No movement, however large, is told in fewer pairs, whatever the monitor is set to.
inline constexpr int soonest_drifted_pairs = 4;

struct DriftOptions {
  std::vector<KnockSize> knocks;
  double rate_deg_per_hour = 0;  // instead of knocks; 0: knocks
  int pairs = 0;                 // from the knock on; 0: those of two hours
  int sequences = 200;           // of each knock
  int estimates = 8;             // of each knock's size
  double weeks = 10000;          // of vehicles whose LiDAR stays
  double driving_hours_per_week = 56;
  double false_alerts_per_1000_vehicle_weeks = 1;
  std::optional<int> block;
  std::filesystem::path json;
};
inline constexpr int usual_drift_frames = 96;
/// What a monitor says of LiDARs that stay in their place and of LiDARs that move: sequences of pairs, drawn from what
/// the frames were measured to say.
[[nodiscard]] Result<Doubts> drift(const RecordingOptions& recording_frames, const DriftOptions& options,
                                   const CommandWords& words);

/// Becomes the program that draws `result` into `folder`; returns only when that cannot be run. Fails with
/// `plot_missing`.
[[nodiscard]] Result<void> plot(const std::filesystem::path& result, const std::filesystem::path& folder);

}  // namespace calib::eval
