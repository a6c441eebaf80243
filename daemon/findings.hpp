#pragma once

#include <chrono>
#include <cstdint>
#include <initializer_list>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "calib/extrinsic_check.hpp"
#include "config.hpp"
#include "dds/decode.hpp"
#include "dds/discovery.hpp"
#include "depth/kind.hpp"

namespace calib {

/// What arrived on one topic of a pair while it was listened to.
struct TopicObservation {
  std::string check{};  // name of its finding: image, right_image, cloud, camera_info, ...
  std::string key{};    // of the configuration, such as camera.image
  std::string topic{};
  std::string type{};  // that calibd expects, from `ros_type_name`
  /// False: it is not configured, but named by convention.
  bool configured = true;
  std::uint64_t messages = 0;
  /// Number of messages that could not be used, by the word of their error code.
  std::map<std::string, std::uint64_t> malformed{};
  std::string malformed_context{};  // of the last one
  /// What was wrong in messages that were used all the same, by the word of its code: the last one.
  std::map<std::string, Error> remarks{};
  std::string frame_id{};  // of the last message, escaped; empty where it names none
  /// Arrival minus stamp, of the message for which it is nearest to zero.
  std::optional<std::chrono::nanoseconds> age{};
  std::optional<std::chrono::nanoseconds> last_stamp{};
  std::uint64_t repeated_stamps = 0;
};

/// Depth from the samples of a pair, and how the cloud agrees with it.
struct DepthTrial {
  double valid_share = 0;
  std::optional<DepthAgreement> agreement{};
};

/// What was observed of a pair: the input of `diagnose`.
struct PairObservation {
  Camera camera;
  DepthSourceKind depth_kind;
  std::string pair{};
  std::uint32_t domain = 0;  // of DDS
  std::string interface {};
  std::chrono::nanoseconds listened{};  // for how long
  std::vector<TopicObservation> topics{};
  std::vector<RemoteWriter> writers{};    // of all topics
  std::set<std::string> topics_in_use{};  // configured for something: not suggested in place of a wrong topic
  std::optional<ImageSize> image{};
  /// Why right or depth images were refused for their size; topic and key of the configuration.
  std::optional<std::string> companion_mismatch{};
  std::optional<CameraInfo> camera_info{};
  std::optional<CloudStatistics> cloud{};
  bool has_reflectance = true;              // of the cloud
  FrameName camera_frame{}, lidar_frame{};  // as configured
  /// Of a pair of samples, or why there is none.
  Result<std::chrono::nanoseconds> time_difference = fail(ErrorCode::sensor_silent, "nothing arrived");
  /// Why the scene is not suitable (dark, ...).
  std::optional<Error> scene{};
  /// From the pair's depth source, or why it failed.
  Result<DepthTrial> depth = fail(ErrorCode::no_pair, "there is no pair of samples to compute it from");
  double min_valid_depth = 0;
  std::optional<ExtrinsicOpinion> extrinsic{};  // compared with depth, if there is any
  std::optional<DepthTrial> swapped{};          // of a stereo pair with the left and right image exchanged
  /// With the lens of CameraInfo instead of the configured one, if they differ.
  std::optional<DepthAgreement> info_agreement{};
};

/// `not_checked`: there was no data to check; `seen` says why. Does not mean ok.
enum class FindingResult { ok, warning, problem, not_checked };
[[nodiscard]] std::string_view to_string(FindingResult result);

/// The result of one check of a pair. `code` is stable and set for warnings and problems. The others are sentences for
/// people; they may quote untrusted text.
struct Finding {
  std::string check;
  FindingResult result = FindingResult::ok;
  std::string code, seen, cause, remedy;
};

/// One finding per topic, then `clock`, `frames`, `pairing`, `image_size`, `lens`, `cloud_range`, `scene`, `depth`,
/// `extrinsic` and `agreement`. A check whose result would only follow from a problem that was found before is
/// `not_checked`.
[[nodiscard]] std::vector<Finding> diagnose(const PairObservation& seen);

/// The part of `diagnose` about topics, clocks and pairing.
void diagnose_samples(const PairObservation& seen, std::vector<Finding>& findings);
/// The part of `diagnose` about sizes, lenses, ranges, depth and the extrinsic.
void diagnose_geometry(const PairObservation& seen, std::vector<Finding>& findings);
/// "1.5 s", "12 min", "56 years", without the sign.
[[nodiscard]] std::string duration_words(std::chrono::nanoseconds time);
/// Whether one of these checks found a problem.
[[nodiscard]] bool has_problem(const std::vector<Finding>& findings, std::initializer_list<std::string_view> checks);

}  // namespace calib
