#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calib_eval/footage.hpp"
#include "calib_eval/landscape.hpp"

namespace calib::eval {

/// What a command says about itself in its result: its words without those that change nothing in it.
using CommandWords = std::vector<std::string>;

struct CalibrateOptions {
  std::vector<Method> methods{Method::standard};
  int degrees_of_freedom = 3;
  std::vector<double> rotation_deg, translation_cm;  // every one with every other
  int starts = 200;
  std::filesystem::path json, figures;  // empty: not wanted
};
/// Runs every cell, with a line of the table for each.
[[nodiscard]] Result<void> calibrate(const FootageOptions& footage, const CalibrateOptions& options,
                                     const CommandWords& words);

struct LandscapeOptions {
  std::vector<Method> methods{Method::standard};
  int degrees_of_freedom = 6;
  LookAround around;
  std::vector<std::array<int, 2>> axis_pairs;  // for surfaces
  std::filesystem::path json;
};
/// Scores along each axis, with where they are best.
[[nodiscard]] Result<void> curves(const FootageOptions& footage, const LandscapeOptions& options,
                                  const CommandWords& words);
/// Scores over pairs of axes.
[[nodiscard]] Result<void> surfaces(const FootageOptions& footage, const LandscapeOptions& options,
                                    const CommandWords& words);

/// Becomes the program that draws `result` into `folder`; returns only when that cannot be run. Fails with
/// `plot_missing`.
[[nodiscard]] Result<void> plot(const std::filesystem::path& result, const std::filesystem::path& folder);

}  // namespace calib::eval
