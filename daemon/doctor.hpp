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
#include "dds/decode.hpp"
#include "dds/discovery.hpp"
#include "depth/kind.hpp"

namespace calib {

/// One topic of a pair, as it was for the seconds in which it was listened to.
struct TopicSeen {
  std::string check{};  // what its finding is called: image, right_image, cloud, camera_info, ...
  std::string key{};    // where the configuration names it, such as camera.image
  std::string topic{};
  std::string type{};  // the one that calibd reads, as `ros_type_name` gives it
  /// False: it is not configured, and only looked at because it is there by convention.
  bool configured = true;
  std::uint64_t messages = 0;
  /// Messages that could not be used: why, and how many.
  std::map<std::string, std::uint64_t> malformed{};
  std::string malformed_context{};  // of the last one
  /// Arrival minus stamp of the message for which it is nearest to zero.
  std::optional<std::chrono::nanoseconds> age{};
  std::optional<std::chrono::nanoseconds> last_stamp{};
  std::uint64_t repeated_stamps = 0;
};

/// What another way to take the same sensors' images and settings comes to.
struct DepthTrial {
  double valid_share = 0;
  std::optional<DepthAgreement> agreement{};
};

/// All that can be seen of a pair from its samples; `diagnose` makes sense of it.
struct PairSeen {
  Camera camera;
  DepthKind depth_kind;
  std::string pair{};
  std::uint32_t domain = 0;
  std::string interface {};
  std::chrono::nanoseconds listened{};
  std::vector<TopicSeen> topics{};
  std::vector<RemoteWriter> writers{};     // on any topic
  std::set<std::string> claimed_topics{};  // not what was meant: they serve something else
  std::optional<ImageSize> image{};
  /// Of right or depth images of another size than the configured one: which, and what is to be corrected.
  std::optional<std::string> companion_size{};
  std::optional<CameraInfo> camera_info{};
  std::optional<CloudCensus> cloud{};
  /// Samples that belong together, or why there are none.
  Result<std::chrono::nanoseconds> time_difference = fail(ErrorCode::sensor_silent, "nothing arrived");
  /// Why the scene itself is of little use (dark, ...).
  std::optional<Error> scene{};
  /// Of the pair's own source of depth, which may have refused to work from the start on.
  Result<DepthTrial> depth = fail(ErrorCode::no_pair, "there is no pair of samples to compute it from");
  double min_valid_depth = 0;
  std::optional<ExtrinsicOpinion> extrinsic{};  // with depth, where there is depth
  std::optional<DepthTrial> swapped{};          // stereo, with the left and right image exchanged
  std::optional<DepthAgreement> told_lens{};    // with the lens that CameraInfo tells of, where it tells of another
};

/// `not_checked`: there was nothing to judge it by; `seen` says why. Not to be read as ok.
enum class FindingResult { ok, warning, problem, not_checked };
[[nodiscard]] std::string_view to_string(FindingResult result);

/// One check of one pair. `code` is a stable word, for warnings and problems; the rest are sentences for a person,
/// which may quote text from outside.
struct Finding {
  std::string check;
  FindingResult result = FindingResult::ok;
  std::string code, seen, cause, remedy;
};

/// What is wrong with a pair, by what was seen of it, and what to do about it: one finding per topic, then `clock`,
/// `pairing`, `image_size`, `lens`, `cloud_range`, `scene`, `depth`, `extrinsic` and `agreement`. What follows from a
/// problem that is found is `not_checked`, so that the cause stands out.
[[nodiscard]] std::vector<Finding> diagnose(const PairSeen& seen);

/// The part of `diagnose` about topics, clocks and what belongs together.
void diagnose_samples(const PairSeen& seen, std::vector<Finding>& findings);
/// The part about sizes, lenses, ranges, depth and the extrinsic.
void diagnose_geometry(const PairSeen& seen, std::vector<Finding>& findings);
/// Whether a check of one of these names has found a problem.
[[nodiscard]] bool has_problem(const std::vector<Finding>& findings, std::initializer_list<std::string_view> checks);

}  // namespace calib
