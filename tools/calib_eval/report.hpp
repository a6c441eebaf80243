#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "calib_eval/doubts.hpp"
#include "calib_eval/experiment.hpp"
#include "calib_eval/figures.hpp"
#include "calib_eval/landscape.hpp"

namespace calib::eval {

/// In the order in which it is written.
using Json = nlohmann::ordered_json;

/// What every result begins with: what was done to which frames. `kind` is calibrate, curve, surface or drift.
[[nodiscard]] Json describe(const char* kind, const std::vector<std::string>& command, const RecordingOptions& options,
                            const RecordingFrames& recording_frames);

[[nodiscard]] Json to_json(const Experiment& experiment);
[[nodiscard]] Json to_json(const Doubts& doubts);
/// Of cell number `cell`, each.
[[nodiscard]] Json runs_to_json(const Experiment& experiment, std::size_t cell);
/// Overlays are named relative to `base`, the folder of the result.
[[nodiscard]] Json to_json(const Figure& figure, std::size_t cell, const std::filesystem::path& base);
[[nodiscard]] Json to_json(const Curve& curve, Method method, int degrees_of_freedom);
[[nodiscard]] Json to_json(const Surface& surface, Method method, int degrees_of_freedom);

/// A line of the table on standard output, and the line above them all.
[[nodiscard]] std::string table_heading();
[[nodiscard]] std::string table_line(const Experiment& experiment);

/// Where a result goes. A file is replaced as a whole, so that it can be read at any time and an older result stays
/// until there is a newer one; symbolic links are followed, unless somebody else has made them. A pipe or a device is
/// written to as it is, once.
class ResultFile {
 public:
  /// `file` empty: not wanted. Fails with `write_failed` where it could not be written; changes nothing.
  [[nodiscard]] static Result<ResultFile> at(const std::filesystem::path& file);
  /// Says in the result whether it is `complete`. Fails with `write_failed`.
  [[nodiscard]] Result<void> write(Json& json, bool complete) const;

 private:
  std::filesystem::path named_, file_;  // as it was named, and behind all links
  bool replaced_ = true;
};

}  // namespace calib::eval
