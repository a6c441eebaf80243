#include "dataset/rosbag2.hpp"

#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <memory>
#include <span>

#include "dataset/bag/bag_frames.hpp"
#include "dataset/bag/bag_topics.hpp"
#include "dataset/bag/ros_message.hpp"
#include "dataset/bag/transform_tree.hpp"
#include "dataset/calibration_file.hpp"
#include "dds/stereo_cameras.hpp"

namespace calib {
namespace {

constexpr const char* size_key = "its CameraInfo or --calibration";

/// What `decode` makes of the first message of a topic that can be decoded, among a few.
template <typename Decode>
auto first_of(const Bag& bag, const BagTopic& topic, const Decode& decode) -> decltype(decode(Octets())) {
  constexpr std::size_t tried = 20;
  const auto messages = bag.messages(topic);
  std::optional<Error> error;
  for (const Bag::Message& message : std::span(messages).first(std::min(tried, messages.size()))) {
    auto bytes = bag.read(message);
    auto decoded = bytes ? decode(*std::move(bytes)) : decltype(decode(Octets()))(propagate(bytes));
    if (decoded) return decoded;
    if (!error) error = decoded.error();
  }
  if (!error) return fail(ErrorCode::bad_topic, topic.name + " has no message that is read");
  return fail(error->code, "no message of " + topic.name + " can be used: " + error->context);
}

Eigen::Matrix3d rotation_of(const CameraInfo& info) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(info.R.data());
}
/// Whether images are turned when they are rectified. R is zero where a driver does not give it.
bool turns(const CameraInfo& info) {
  const Eigen::Matrix3d R = rotation_of(info);
  return !R.isIdentity(1e-12) && (R * R.transpose() - Eigen::Matrix3d::Identity()).norm() < 1e-3 && R.determinant() > 0;
}

/// The camera that an image of CameraInfo is of: P's where it is rectified, or K's where P is zero; else K's and D's.
Result<Camera> camera_of(const CameraInfo& info, bool is_rectified) {
  const bool has_no_lens = std::ranges::all_of(info.D, [](double d) { return d == 0; });
  const std::vector<double> of_P{info.P[0], info.P[5], info.P[2], info.P[6]},
      of_K{info.K[0], info.K[4], info.K[2], info.K[5]};
  if (is_rectified || info.K[0] == 0)
    return Camera::make(CameraModel::rectified, info.width, info.height, info.P[0] != 0 ? of_P : of_K);
  if (has_no_lens && !turns(info)) return Camera::make(CameraModel::rectified, info.width, info.height, of_K);
  return Camera::make(info.model, info.width, info.height, of_K, info.D);
}

/// Everything that is found out before frames are read.
class Opening {
 public:
  Opening(Bag bag, const BagOptions& options) : bag_(std::make_shared<const Bag>(std::move(bag))), options_(options) {
    remarks_ = bag_->remarks();
  }

  [[nodiscard]] Result<Recording> open() {
    if (!options_.calibration.empty()) {
      auto file = read_calibration_file(options_.calibration);
      if (!file) return propagate(file);
      file_ = *std::move(file);
    }
    auto topics = choose_topics(*bag_, options_);
    if (!topics) return propagate(topics);
    topics_ = *std::move(topics);
    const auto image = first_of(*bag_, topics_.image, [&](Octets bytes) {
      return image_in(std::move(bytes), topics_.image, Colour::none, {});
    });
    if (!image) return propagate(image);
    auto camera = find_camera(*image);
    if (!camera) return propagate(camera);
    const auto T_camera_lidar = find_extrinsic(*image);
    if (!T_camera_lidar) return propagate(T_camera_lidar);
    std::optional<RightCamera> right;
    if (topics_.right_image) {
      auto found = find_right_camera(*camera, image->notes.frame_id);
      const bool is_wanted = options_.needs_right_image || !options_.right_image.empty();
      if (!found && is_wanted) return propagate(found);
      if (found) right = *std::move(found);
    }
    std::optional<DepthCamera> depth;
    if (topics_.depth) {
      auto found = find_depth_camera(*camera, image->notes.frame_id);
      if (!found) return propagate(found);
      depth = *std::move(found);
    }
    return read_frames(*std::move(camera), *T_camera_lidar, right, depth);
  }

 private:
  [[nodiscard]] bool is_rectified(const BagTopic& topic) const {
    return options_.image_is.empty() ? names_rectified_images(topic.name) : options_.image_is == "rectified";
  }

  [[nodiscard]] Result<Camera> find_camera(const Image& image) {
    if (topics_.info) {
      auto info = first_of(*bag_, *topics_.info, info_in);
      if (!info && !file_.camera) return propagate(info);
      if (info) info_ = *std::move(info);
    }
    if (file_.camera) {
      said_ += ", the camera of " + options_.calibration.string();
      return *file_.camera;
    }
    if (!info_)
      return fail(ErrorCode::camera_info_missing, "no topic of the recording has the CameraInfo of " +
                                                      topics_.image.name + "; it holds " + list_of(bag_->topics()) +
                                                      "; name one with --info-topic, or give the camera in a file with "
                                                      "--calibration");
    said_ +=
        ", " + topics_.info->name + (is_rectified(topics_.image) ? " (P: rectified images)" : " (K, D: raw images)");
    remark_on_changes(*topics_.info);
    if (info_->P[3] != 0 && is_rectified(topics_.image))
      remarks_.push_back("P of " + topics_.info->name + " has an offset to another camera (P[3] is " +
                         std::to_string(info_->P[3]) + "), which is not used: the transform of the image's frame is");
    auto camera = camera_of(*info_, is_rectified(topics_.image));
    if (!camera) return camera;
    if (camera->width() == image.width && camera->height() == image.height) return camera;
    const std::string sizes = "images of " + topics_.image.name + " have " + std::to_string(image.width) + " x " +
                              std::to_string(image.height) + " pixels, and " + topics_.info->name + " is for " +
                              std::to_string(camera->width()) + " x " + std::to_string(camera->height());
    const double across = double(image.width) / camera->width(), down = double(image.height) / camera->height();
    if (std::abs(across / down - 1) > 0.01) return fail(ErrorCode::camera_info_mismatch, sizes);
    remarks_.push_back(sizes + ": its numbers are scaled");
    return camera->resized(image.width, image.height);
  }

  /// Only the first and the last one are compared: a camera that is calibrated anew, or two that share a topic.
  void remark_on_changes(const BagTopic& topic) {
    const auto last = bag_->read(bag_->messages(topic).back()).and_then(info_in);
    if (last && (last->K != info_->K || last->D != info_->D || last->P != info_->P || last->width != info_->width))
      remarks_.push_back(topic.name + " changes during the recording: its first message is used");
  }

  /// Of the recording's transforms: /tf is read only where /tf_static is not sufficient.
  [[nodiscard]] Result<RigidTransform> transform(const std::string& to, const std::string& from) {
    const auto add = [&](TransformTree::Topic kind, std::string_view ending) {
      for (const BagTopic& topic : bag_->topics())
        if (topic.is(bag_type::transforms) && topic.name.ends_with(ending))
          for (const Bag::Message& message : bag_->messages(topic))
            if (const auto read = bag_->read(message).and_then(
                    [](const Octets& bytes) { return RosMessage::read(bytes, transforms_type); }))
              tree_.add(read->as<tf2_msgs_msg_dds__TFMessage_>(), kind);
    };
    if (!std::exchange(has_static_, true)) add(TransformTree::Topic::tf_static, "/tf_static");
    if (!tree_.connects(to, from) && !std::exchange(has_moving_, true)) add(TransformTree::Topic::tf, "/tf");
    return tree_.find(to, from);
  }

  [[nodiscard]] Result<RigidTransform> find_extrinsic(const Image& image) {
    if (file_.T_camera_lidar) {
      said_ += ", T_camera_lidar of " + options_.calibration.string();
      return *file_.T_camera_lidar;
    }
    const auto cloud = first_of(*bag_, topics_.cloud, cloud_in);
    if (!cloud) return propagate(cloud);
    const std::string camera_frame = frame_name(image.notes.frame_id.c_str()),
                      lidar_frame = frame_name(cloud->notes.frame_id.c_str());
    const char* const remedy = "; give T_camera_lidar in a file with --calibration";
    if (camera_frame.empty() || lidar_frame.empty())
      return fail(ErrorCode::calibration_missing,
                  "messages of " + (camera_frame.empty() ? topics_.image.name : topics_.cloud.name) +
                      " name no frame (header.frame_id is empty), so that no transform is known" + remedy);
    auto T_camera_lidar = transform(camera_frame, lidar_frame);
    if (!T_camera_lidar) {
      T_camera_lidar.error().context += remedy;
      return T_camera_lidar;
    }
    said_ += ", the transform from " + lidar_frame + " to " + camera_frame + " of /tf_static" +
             (has_moving_ ? " and /tf" : "");
    if (!info_ || !is_rectified(topics_.image) || !turns(*info_)) return T_camera_lidar;
    // A rectified image is turned from the camera's frame, which its header names all the same.
    remarks_.push_back("images are rectified by a rotation R of " + topics_.info->name +
                       ", which is taken to follow the transform of their frame");
    return RigidTransform(Eigen::Quaterniond(rotation_of(*info_)).normalized()) * *T_camera_lidar;
  }

  [[nodiscard]] Result<RightCamera> find_right_camera(const Camera& left, const std::string& left_frame) {
    said_ += ", " + topics_.right_image->name;
    if (file_.baseline_m) return rectified_right_camera(left, *file_.baseline_m);
    if (!topics_.right_info)
      return fail(ErrorCode::camera_info_missing,
                  "no topic of the recording has the CameraInfo of " + topics_.right_image->name +
                      "; name one with --right-info-topic, or give baseline_m in a file with --calibration");
    const auto info = first_of(*bag_, *topics_.right_info, info_in);
    if (!info) return propagate(info);
    said_ += ", " + topics_.right_info->name;
    if (info->P[3] < 0) return right_camera(left, {info_, *info});
    // Cameras that know nothing of each other: by their transform.
    auto camera = camera_of(*info, is_rectified(*topics_.right_image));
    if (!camera) return propagate(camera);
    const auto T_right_left = transform(info->notes.frame_id, left_frame);
    if (T_right_left && !T_right_left->translation().isZero()) return RightCamera{*std::move(camera), *T_right_left};
    return fail(ErrorCode::calibration_missing,
                "P of " + topics_.right_info->name + " has no baseline (P[3] = -fx * baseline), and no transform to '" +
                    info->notes.frame_id + "' is known; give baseline_m in a file with --calibration");
  }

  /// Nothing: the depth is of the image's own pixels.
  [[nodiscard]] Result<std::optional<DepthCamera>> find_depth_camera(const Camera& camera, const std::string& frame) {
    said_ += ", depth of " + topics_.depth->name;
    const auto depth =
        first_of(*bag_, *topics_.depth, [&](Octets bytes) { return depth_in(std::move(bytes), *topics_.depth, {}); });
    if (!depth) return propagate(depth);
    depth_bound_ = ImageBound::scaled(size_of(camera), size_key);
    if (depth->notes.frame_id == frame || depth->notes.frame_id.empty()) return std::nullopt;
    const auto T_camera_depth = transform(frame, depth->notes.frame_id);
    if (!T_camera_depth) return propagate(T_camera_depth);
    const auto info_topic = info_beside(*bag_, *topics_.depth);
    if (!info_topic)
      return fail(ErrorCode::camera_info_missing, "depth of " + topics_.depth->name + " is of the frame '" +
                                                      depth->notes.frame_id + "', whose CameraInfo is not there");
    const auto info = first_of(*bag_, *info_topic, info_in);
    if (!info) return propagate(info);
    auto own = camera_of(*info, true);
    if (!own) return propagate(own);
    depth_bound_ = ImageBound::exactly(size_of(*own), "its CameraInfo");
    return DepthCamera{*std::move(own), *T_camera_depth};
  }

  /// Those with a stamp that no other one of the topic has, in the order of stamps.
  [[nodiscard]] Result<StampedMessages> stamped(const BagStream& stream) {
    const auto& [topic, messages, bound] = stream;
    StampedMessages all;
    for (std::size_t i = 0; i < messages.size(); ++i)
      if (messages[i].place.stamp != BagMessage::no_stamp) all.push_back({messages[i].place.stamp, i});
    if (const std::size_t left = messages.size() - all.size(); left > 0)
      remarks_.push_back(std::to_string(left) + " of " + std::to_string(messages.size()) + " messages of " +
                         topic.name + " have no valid stamp and are left out");
    std::ranges::stable_sort(all, {}, &StampedMessage::stamp);
    const std::size_t count = all.size();
    all.erase(std::ranges::unique(all, {}, &StampedMessage::stamp).begin(), all.end());
    if (count > all.size() && all.size() == 1)
      return fail(ErrorCode::frame_mismatch, "all " + std::to_string(count) + " messages of " + topic.name +
                                                 " have the stamp " + stamp_name(all.front().stamp) +
                                                 " ns: what belongs together cannot be told");
    if (count > all.size())
      remarks_.push_back(std::to_string(count - all.size()) + " messages of " + topic.name +
                         " have the stamp of another one and are left out");
    return all;
  }

  [[nodiscard]] Result<Recording> read_frames(Camera camera, const RigidTransform& T_camera_lidar,
                                              const std::optional<RightCamera>& right,
                                              const std::optional<DepthCamera>& depth) {
    const ImageBound bound = ImageBound::exactly(size_of(camera), size_key).with_significant_bits(file_.image_bits);
    const auto frames = std::make_shared<BagFrames>();
    frames->bag = bag_;
    frames->images = {topics_.image, bag_->messages(topics_.image), bound};
    frames->scans = {topics_.cloud, bag_->messages(topics_.cloud)};
    if (right)
      frames->right_images = {
          *topics_.right_image, bag_->messages(*topics_.right_image),
          ImageBound::exactly(size_of(right->camera), "the right CameraInfo").with_significant_bits(file_.image_bits)};
    if (topics_.depth) frames->depths = {*topics_.depth, bag_->messages(*topics_.depth), depth_bound_};
    const auto images = stamped(frames->images), scans = stamped(frames->scans);
    const auto right_images = stamped(frames->right_images), depths = stamped(frames->depths);
    for (const auto* stream : {&images, &scans, &right_images, &depths})
      if (!*stream) return propagate(*stream);
    frames->pairs = pair_by_stamp(*images, *scans, right ? &*right_images : nullptr, topics_.depth ? &*depths : nullptr,
                                  std::chrono::nanoseconds(std::llround(1e6 * options_.max_time_difference_ms)));
    if (frames->pairs.pairs.empty())
      return fail(ErrorCode::frame_mismatch, "no image of " + topics_.image.name + " and cloud of " +
                                                 topics_.cloud.name + " belong together: " + frames->pairs.why_none);
    RecordedFrames names{{}, frames->pairs.lacks};
    for (const RecordedPair& pair : frames->pairs.pairs)
      names.complete.push_back({stamp_name(pair.image.stamp), {}, std::nullopt, {}});

    Recording recording(std::move(camera), T_camera_lidar, right, std::move(names),
                        [frames](std::size_t index, Colours colours) {
                          return frames->read(index, colours == Colours::rgb ? Colour::rgb : Colour::none);
                        });
    if (right && right->T_right_left.linear().isIdentity())
      recording.set_baseline_m(-right->T_right_left.translation().x());
    if (topics_.depth) recording.set_depth(depth);
    remarks_.insert(remarks_.begin(), "reads " + topics_.image.name + ", " + topics_.cloud.name + said_);
    remarks_.insert(remarks_.end(), tree_.remarks().begin(), tree_.remarks().end());
    recording.set_remarks(std::move(remarks_));
    return recording;
  }

  std::shared_ptr<const Bag> bag_;
  BagOptions options_;
  BagTopics topics_;
  CalibrationFile file_;
  std::optional<CameraInfo> info_;
  TransformTree tree_;
  bool has_static_ = false, has_moving_ = false;
  ImageBound depth_bound_;
  std::string said_;  // which topics and files
  std::vector<std::string> remarks_;
};

}  // namespace

Result<Recording> open_rosbag2(const std::filesystem::path& path, const BagOptions& options) {
  auto bag = Bag::open(path);
  if (!bag) return propagate(bag);
  return Opening(*std::move(bag), options).open();
}

}  // namespace calib
