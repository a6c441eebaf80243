#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "camera_info_check.hpp"
#include "findings.hpp"
#include "message_faults.hpp"

namespace calib {
namespace {

/// Rank correlation of depth and cloud: above `agreeing` they agree, below `unrelated` they do not.
constexpr double agreeing = 0.5, unrelated = 0.3;
/// By how much one lens must agree better than another.
constexpr double clear_difference = 0.05;

Finding fine(std::string check, std::string what) {
  return {std::move(check), FindingResult::ok, {}, std::move(what), {}, {}};
}

Finding not_checked(std::string check, std::string why) {
  return {std::move(check), FindingResult::not_checked, {}, std::move(why), {}, {}};
}

Finding problem(std::string check, std::string code, std::string what, std::string cause, std::string remedy) {
  return {std::move(check), FindingResult::problem, std::move(code),
          std::move(what),  std::move(cause),       std::move(remedy)};
}

std::string size_words(int width, int height) { return fmt::format("{} x {}", width, height); }

Finding judge_image_size(const PairObservation& seen) {
  if (!seen.image) return not_checked("image_size", "no image arrived");
  const int width = seen.camera.width(), height = seen.camera.height();
  const std::string what = fmt::format("images are {} pixels", size_words(seen.image->width, seen.image->height));
  if (*seen.image == ImageSize{width, height} && seen.companion_mismatch)
    return problem("image_size", "image_size_mismatch", *seen.companion_mismatch,
                   "the driver publishes another resolution or a part of the sensor, or this is another camera's topic",
                   "correct the size and the intrinsics there, or the topic");
  if (*seen.image == ImageSize{width, height}) return fine("image_size", what + ", as configured");
  const double across = static_cast<double>(seen.image->width) / width;
  const double down = static_cast<double>(seen.image->height) / height;
  const bool scaled = std::abs(across / down - 1) < 0.01;
  const bool told = seen.camera_info && seen.camera_info->width == seen.image->width &&
                    seen.camera_info->height == seen.image->height;
  return problem(
      "image_size", "image_size_mismatch", what + ", camera.size is " + size_words(width, height),
      scaled ? fmt::format("the driver publishes them scaled by {:.3g}", across)
             : "the driver publishes another resolution or a part of the sensor, or this is another camera's topic",
      fmt::format("write size: [{}, {}] and the intrinsics for images of that size{}", seen.image->width,
                  seen.image->height, told ? ", which CameraInfo has" : ""));
}

bool is_distorted(const CameraInfo& info) {
  return std::ranges::any_of(info.D, [](double value) { return value != 0; });
}

/// Lens models that CameraInfo cannot describe.
bool is_unknown_to_camera_info(CameraModel model) { return !facts(model).ros; }

std::string lens_words(const CameraInfo& info) {
  return is_distorted(info) ? "model " + std::string(to_string(info.model)) : "no distortion";
}

/// Whether depth agrees clearly better with the lens of CameraInfo than with the configured one.
bool info_agrees_better(const PairObservation& seen) {
  const auto& given = seen.extrinsic ? seen.extrinsic->agreement : std::nullopt;
  const auto& other = seen.info_agreement;
  return other && (!given || other->rank_correlation > given->rank_correlation + clear_difference);
}

/// CameraInfo does not say whether the images are rectified. The name of the topic does by convention, and depth agrees
/// better with the right one.
Finding judge_rectified(const PairObservation& seen, const std::string& what) {
  const bool better = info_agrees_better(seen);
  const bool named = std::ranges::any_of(seen.topics, [](const TopicObservation& topic) {
    return topic.check == "image" && topic.topic.find("rect") != std::string::npos;
  });
  if (named && !better) return fine("lens", what + ", and the topic's name says that the images are rectified");
  Finding finding = problem("lens", "wrong_lens_model", what + " of the raw images",
                            "camera.model is rectified, and these images probably are not",
                            "use the rectified topic (image_rect), or write the camera's own model and distortion");
  if (!better) finding.result = FindingResult::warning;
  return finding;
}

/// CameraInfo names another model than the configuration. Drivers name models wrongly, plumb_bob for a fisheye for
/// example, so that a name alone is a warning: depth decides.
Finding judge_model(const PairObservation& seen, const std::string& what, bool intrinsics_differ) {
  const CameraInfo& info = *seen.camera_info;
  Finding finding =
      problem("lens", "wrong_lens_model", what, "camera.model is " + std::string(to_string(seen.camera.model())),
              is_distorted(info) ? fmt::format("write model: {} and its distortion", to_string(info.model))
                                 : "write model: rectified, without distortion");
  const auto& given = seen.extrinsic ? seen.extrinsic->agreement : std::nullopt;
  if (intrinsics_differ || !given || !seen.info_agreement || info_agrees_better(seen)) return finding;
  // One without distortion is no label: a fisheye that was rectified has none.
  const bool clearly_worse = seen.info_agreement->rank_correlation < given->rank_correlation - clear_difference;
  if (!is_distorted(info) && !clearly_worse) return finding;
  finding.result = FindingResult::warning;
  finding.seen += fmt::format("; depth agrees no better with that lens ({:.2f}) than with the configured one ({:.2f})",
                              seen.info_agreement->rank_correlation, given->rank_correlation);
  finding.cause += ", or the driver names the model of its lens wrongly";
  finding.remedy = "leave it if the configuration is that of a calibration; else " + finding.remedy;
  return finding;
}

Finding judge_lens(const PairObservation& seen, const std::vector<Finding>& findings) {
  if (!seen.camera_info) return not_checked("lens", "no CameraInfo arrived to compare the configured lens with");
  if (has_problem(findings, {"image_size"})) return not_checked("lens", "correct the size of the image first");
  const CameraInfo& info = *seen.camera_info;
  const Camera& camera = seen.camera;
  const auto differs = contradiction(info, camera);
  if (differs && differs->of == CameraInfoContradiction::Of::size)
    return problem("lens", "camera_info_mismatch", differs->seen,
                   info.reduced_from.empty()
                       ? "it is another camera's, or the configuration is for another resolution"
                       : "the driver applies binning or roi to width, height and K already, and states them once more; "
                         "or the configuration is for another resolution",
                   (info.reduced_from.empty() ? "" : "write camera.info_reduction: ignored if it does; else ") +
                       std::string("correct camera.size and intrinsics, or camera.info; without camera.info it is not "
                                   "compared"));
  if (is_unknown_to_camera_info(camera.model()))
    return not_checked("lens", "CameraInfo cannot describe the model " + std::string(to_string(camera.model())));
  const std::string what = "CameraInfo describes " + lens_words(info);
  const bool rectified = camera.model() == CameraModel::rectified;
  const bool straight = std::ranges::all_of(camera.distortion(), [](double value) { return value == 0; });
  if (!rectified &&
      (is_distorted(info) ? info.model != camera.model() : !straight || camera.model() == CameraModel::equidistant))
    return judge_model(seen, what, differs.has_value());
  if (differs)
    return problem(
        "lens", "intrinsics_mismatch", differs->seen,
        info.reduced_from.empty()
            ? "the intrinsics are another camera's, or of another resolution or calibration"
            : "the driver states K and P for the image as it is, beside a binning or roi; or the intrinsics are "
              "another camera's, or of another resolution or calibration",
        (info.reduced_from.empty() ? "" : "write camera.info_reduction: size_only if it does; else ") +
            std::string("write the intrinsics of CameraInfo, if that is the right one"));
  if (rectified && is_distorted(info)) return judge_rectified(seen, what);
  return fine("lens", what + ", with the configured intrinsics");
}

/// The unit in which the median range would be nearest to an ordinary one (12 m); empty for metres.
std::string probable_unit(double median_range) {
  struct Unit {
    const char* name;
    double per_metre;
  };
  constexpr std::array units{Unit{"millimetres", 1000}, Unit{"centimetres", 100}, Unit{"", 1},
                             Unit{"kilometres", 0.001}};
  constexpr double ordinary_m = 12;
  const auto strangeness = [&](const Unit& unit) {
    return std::abs(std::log(median_range / unit.per_metre / ordinary_m));
  };
  return std::ranges::min_element(units, {}, strangeness)->name;
}

Finding judge_cloud_range(const PairObservation& seen) {
  if (!seen.cloud) return not_checked("cloud_range", "no cloud arrived");
  const CloudStatistics& cloud = *seen.cloud;
  const std::uint64_t measured = cloud.points - cloud.not_finite - cloud.at_origin;
  const std::string what = fmt::format("{} points, {} of them measured, median range {:.4g} m, {} beyond 500 m",
                                       cloud.points, measured, cloud.median_range_m, cloud.too_far) +
                           (seen.has_reflectance ? "" : ", without reflectance (no field intensity or the like)");
  if (measured == 0)
    return problem("cloud_range", "empty_cloud", what, "the LiDAR measures nothing, or its driver drops all points",
                   "check the log of the LiDAR's driver");
  if (cloud.median_range_m <= 0) return not_checked("cloud_range", what);
  if (const std::string unit = probable_unit(cloud.median_range_m); !unit.empty())
    return problem("cloud_range", "cloud_unit", what, "its points look like " + unit,
                   "make the driver publish metres, the unit of sensor_msgs/PointCloud2");
  if (cloud.too_far * 20 > measured)
    return {"cloud_range",
            FindingResult::warning,
            "far_points",
            what,
            "the driver marks points without a return so, or publishes another unit",
            "make the driver publish NaN for points without a return"};
  return fine("cloud_range", what);
}

/// A remark of that code on a topic.
const Error* remark(const PairObservation& seen, std::string_view check, ErrorCode code) {
  const auto topic = std::ranges::find(seen.topics, check, &TopicObservation::check);
  if (topic == seen.topics.end()) return nullptr;
  const auto found = topic->remarks.find(std::string(to_string(code)));
  return found == topic->remarks.end() ? nullptr : &found->second;
}

Finding judge_scene(const PairObservation& seen) {
  if (!seen.time_difference) return not_checked("scene", "there is no pair of samples");
  if (const auto bits = remark(seen, "image", ErrorCode::image_bits); bits && seen.scene)
    return {"scene",
            FindingResult::warning,
            std::string(to_string(ErrorCode::image_bits)),
            seen.scene->context + "; " + bits->context,
            std::string(message_fault(ErrorCode::image_bits).cause),
            std::string(message_fault(ErrorCode::image_bits).remedy)};
  if (!seen.scene) return fine("scene", "there is enough light, texture and points");
  return {"scene",
          FindingResult::warning,
          std::string(to_string(seen.scene->code)),
          seen.scene->context,
          "the scene is like that now, or a sensor is covered; such pairs are not evaluated",
          "run this again in a scene with light and texture"};
}

bool swapped(const PairObservation& seen) {
  if (!seen.swapped || !seen.swapped->agreement) return false;
  const double given = seen.extrinsic && seen.extrinsic->agreement ? seen.extrinsic->agreement->rank_correlation : 0;
  const double then = seen.swapped->agreement->rank_correlation;
  return then > agreeing && then > given + 0.2;
}

Finding judge_depth(const PairObservation& seen) {
  if (!seen.depth) {
    const Error& error = seen.depth.error();
    if (error.code == ErrorCode::no_pair) return not_checked("depth", error.context);
    const std::string code(to_string(error.code));
    if (const auto& refused = seen.depth_kind.preparation_failure; refused && error.code == refused->code)
      return problem("depth", code, error.context, std::string(refused->cause), std::string(refused->remedy));
    return problem("depth", code, error.context, "the depth source cannot work with its input",
                   "follow the message; `calibctl check-config` checks a changed configuration");
  }
  const std::string what = fmt::format("{:.0f} % of the image has depth", 100 * seen.depth->valid_share);
  if (swapped(seen))
    return problem("depth", "stereo_swapped",
                   what + fmt::format(", {:.0f} % with left and right exchanged", 100 * seen.swapped->valid_share),
                   "camera.image is the right camera's and the right image the left one's",
                   "exchange the two topics in the configuration");
  if (const auto* sign = remark(seen, "depth_topic", ErrorCode::malformed_disparity_sign);
      sign && seen.depth->valid_share < seen.min_valid_depth) {
    const MessageFault& fault = message_fault(sign->code);
    return problem("depth", std::string(to_string(sign->code)), what + "; " + sign->context, std::string(fault.cause),
                   std::string(fault.remedy));
  }
  if (seen.depth->valid_share < seen.min_valid_depth)
    return problem("depth", "few_valid_depth", what, "the depth source does not get the images that it was made for",
                   std::string(seen.depth_kind.remedies.few_valid));
  return fine("depth", what);
}

/// How depth and cloud agree, once everything else is right.
Finding judge_agreement(const PairObservation& seen, const std::vector<Finding>& findings) {
  if (!seen.extrinsic || !seen.depth) return not_checked("agreement", "there is no depth to compare the cloud with");
  if (has_problem(findings, {"lens", "depth", "extrinsic", "image_size", "cloud_range"}))
    return not_checked("agreement", "correct the other problems first");
  if (!seen.extrinsic->agreement)
    return not_checked("agreement", "too few points of the cloud project onto pixels with depth");
  const DepthAgreement& agreement = *seen.extrinsic->agreement;
  const double correlation = agreement.rank_correlation;
  const std::string what =
      fmt::format("rank correlation of depth and cloud {:.2f}, {} points", correlation, agreement.points);
  if (correlation < -unrelated)
    return problem("agreement", "depth_inverted", what, "depth has near and far exchanged",
                   std::string(seen.depth_kind.remedies.inverted));
  if (seen.info_agreement && seen.info_agreement->rank_correlation > std::max(agreeing, correlation + 0.15))
    return problem("agreement", "wrong_lens_model",
                   what + fmt::format("; {:.2f} with the lens of CameraInfo", seen.info_agreement->rank_correlation),
                   "the configured lens is not that of this camera",
                   "write model, intrinsics and distortion of CameraInfo");
  if (correlation < unrelated)
    return problem("agreement", "depth_unrelated", what,
                   "the extrinsic or the lens is far off, or the depth source does not work with these images",
                   "look at the picture: points and depth should show the same objects in the same places");
  if (correlation < agreeing)
    return {"agreement",
            FindingResult::warning,
            "weak_agreement",
            what,
            "depth is poor, the scene is flat, or the extrinsic is some degrees off",
            "look at the picture, and at the drift that `calibctl status` shows"};
  return fine("agreement", what);
}

/// With metric depth, its ratio to the ranges of the cloud reveals wrong units and baselines.
void judge_scale(const PairObservation& seen, Finding& agreement) {
  if (agreement.result != FindingResult::ok || !seen.depth_kind.is_metric) return;
  const double ratio = seen.extrinsic->agreement->scale;
  agreement.seen += fmt::format("; ranges are {:.2f} times the depth", ratio);
  if (ratio > 0.8 && ratio < 1.25) return;
  const bool feet = std::abs(ratio / 3.2808 - 1) < 0.1;
  agreement.result = feet ? FindingResult::problem : FindingResult::warning;
  agreement.code = feet ? "cloud_unit" : "depth_scale";
  agreement.cause = feet ? "the cloud's points look like feet" : "depth and cloud differ in scale";
  agreement.remedy = feet ? "make the driver publish metres, the unit of sensor_msgs/PointCloud2"
                          : seen.depth_kind.remedies.wrong_scale;
}

Finding judge_extrinsic(const PairObservation& seen, const std::vector<Finding>& findings) {
  if (!seen.extrinsic) return not_checked("extrinsic", "there is no pair of an image and a cloud");
  if (has_problem(findings, {"image_size", "cloud_range"}))
    return not_checked("extrinsic", "correct the other problems first");
  const ExtrinsicOpinion& opinion = *seen.extrinsic;
  std::string what = fmt::format("{} points in the image, camera {}", opinion.points_in_view,
                                 opinion.upright ? "upright" : "on its side");
  if (opinion.plausible() || (swapped(seen) && !opinion.sees_nothing)) return fine("extrinsic", what);
  if (!opinion.likely)
    return problem("extrinsic", "extrinsic_out_of_view", what, "the camera does not look at any points of the cloud",
                   "correct T_camera_lidar: it maps points from the LiDAR's frame to the camera's optical frame; were "
                   "angles written in the wrong unit or order?");
  if (opinion.likely_agreement)
    what += fmt::format("; rank correlation with depth {}, read otherwise {:.2f}",
                        opinion.agreement ? fmt::format("{:.2f}", opinion.agreement->rank_correlation) : "none",
                        opinion.likely_agreement->rank_correlation);
  const auto q = quaternion_xyzw(opinion.likely->T_camera_lidar);
  const auto t = translation_m(opinion.likely->T_camera_lidar);
  return problem("extrinsic", "extrinsic_" + std::string(opinion.likely->code), what,
                 "T_camera_lidar is wrong: " + std::string(opinion.likely->words),
                 fmt::format("if so, write translation_m: [{:.4f}, {:.4f}, {:.4f}] and quaternion_xyzw: [{:.6f}, "
                             "{:.6f}, {:.6f}, {:.6f}]",
                             t[0], t[1], t[2], q[0], q[1], q[2], q[3]));
}

}  // namespace

void diagnose_geometry(const PairObservation& seen, std::vector<Finding>& findings) {
  findings.push_back(judge_image_size(seen));
  findings.push_back(judge_lens(seen, findings));
  findings.push_back(judge_cloud_range(seen));
  findings.push_back(judge_scene(seen));
  findings.push_back(judge_depth(seen));
  findings.push_back(judge_extrinsic(seen, findings));
  findings.push_back(judge_agreement(seen, findings));
  judge_scale(seen, findings.back());
}

}  // namespace calib
