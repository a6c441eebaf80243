#pragma once

#include <cstdint>
#include <map>
#include <nlohmann/json_fwd.hpp>
#include <optional>
#include <string>
#include <vector>

#include "calib/claim.hpp"
#include "calib/geometry.hpp"
#include "calib/wall_time.hpp"

namespace calib {

/// Everything calibd says about itself, collected once; every output (JSON, terminal, diagnostics) formats
/// this.
struct PairStatus {
  std::string name;
  Verdict verdict = Verdict::not_evaluated;
  std::optional<ErrorCode> cause;  // as of `Claim`
  std::string reason;
  /// What the verdict rests on; nothing while this process has evaluated no pair at the extrinsic in force.
  std::optional<Grounds> grounds;
  WallTime since{};
  std::optional<WallTime> last_evaluated;
  std::uint64_t evaluated = 0;
  /// Samples or pairs that were not evaluated, by reason.
  std::map<std::string, std::uint64_t> skipped;

  /// What was wrong in messages that were used all the same, by the word of its code, since calibd started.
  struct Remark {
    std::uint64_t count = 0;
    std::string text;  // of the last one
  };
  std::map<std::string, Remark> remarks;

  struct Score {
    double current = 0, best_neighbour = 0;
    std::optional<double> baseline;
  };
  std::optional<Score> score;

  /// How far the LiDAR seems to have moved in its own frame (rad, m), and one standard deviation.
  struct Misalignment {
    Vector6 delta = Vector6::Zero(), sigma = Vector6::Zero();
  };
  std::optional<Misalignment> misalignment;
  /// Per axis the smallest shift that is detected (rad, m), infinite where the axis is not observable; none before
  /// there is a baseline.
  std::optional<Vector6> detection_limit;
  /// The rotation (rad) that must not go unnoticed, and after how much driving (s) it is noticed about any axis; none
  /// before there is a baseline, and where it could go unnoticed.
  struct Notice {
    double rotation_rad = 0, driving_s = 0;
  };
  std::optional<Notice> notice;

  RigidTransform T_camera_lidar = RigidTransform::Identity();
  /// A computed extrinsic that waits for `calibctl accept`, and its record.
  struct Proposed {
    RigidTransform T_camera_lidar = RigidTransform::Identity();
    std::uint64_t record_sequence = 0;
  };
  std::optional<Proposed> proposed;

  /// The record of the extrinsic in force.
  struct Record {
    std::uint64_t sequence = 0;
    std::string key_id;
    bool verified = false;
    WallTime created{};
  };
  std::optional<Record> record;

  struct Input {
    std::string topic;
    /// Since the last sample was received; none when there was none since the start.
    std::optional<double> age_s;
  };
  Input image, cloud;
  std::optional<Input> right_image, depth, motion;
  std::optional<double> time_difference_ms;
};

/// `misalignment` of one axis (0 .. 5) in words: "0.62 degrees to the left, sigma 0.05", or "not observable".
[[nodiscard]] std::string axis_in_words(const PairStatus& pair, int axis);

struct Status {
  std::string vehicle;
  bool running = false;
  std::string version;
  double uptime_s = 0;
  std::vector<PairStatus> pairs;
  std::uint64_t feed_queued = 0;
  /// Records that calibd has written and that are no longer in the store, in words.
  std::optional<std::string> records_missing{};
  /// Why calibd signs no records, with the remedy: its key is not the one with which the chain ends. Nothing is well
  /// then, whatever the verdicts are.
  std::optional<std::string> signing_refused{};
};

/// Applies `claim` to each pair at `now`: to be done whenever a status is shown that was collected before.
void expire(Status& status, const BootTime& now);

/// The form of proto/status.schema.json; angles in degrees, translations of `misalignment` in centimetres,
/// times as RFC 3339 UTC.
[[nodiscard]] nlohmann::json to_json(const Status& status);

/// Inverse of `to_json`, to the milliseconds of its times; fields it does not know are ignored, so that an
/// older reader understands a newer calibd. Fails with `malformed_status`.
[[nodiscard]] Result<Status> parse_status(const nlohmann::json& json);

}  // namespace calib
