#include "vehicle/publisher.hpp"

#include <dds/dds.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <utility>

#include "ros2.h"

namespace calib::vehicle {
namespace {

constexpr const char* image_hash = "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47";
constexpr const char* camera_info_hash = "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275";
constexpr const char* disparity_hash = "1ec1ff6b5bace919e4544a37f2d96ead9f81783701b7b7a4d97a09325ecf2711";
constexpr const char* imu_hash = "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b";
constexpr const char* odometry_hash = "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0";
constexpr const char* point_cloud_hash = "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5";

tl::unexpected<Error> dds_failed(const std::string& what, dds_return_t code) {
  return fail(ErrorCode::dds_failed, what + ": " + dds_strretcode(code));
}

std_msgs_msg_dds__Header_ header(Timestamp stamp, const char* frame) {
  return {{static_cast<std::int32_t>(stamp.count() / 1'000'000'000),
           static_cast<std::uint32_t>(stamp.count() % 1'000'000'000)},
          const_cast<char*>(frame)};
}

/// A sequence that refers to bytes that stay where they are while the sample is written.
template <typename Sequence>
Sequence borrowed(const void* bytes, std::size_t size) {
  Sequence sequence{};
  sequence._maximum = sequence._length = static_cast<std::uint32_t>(size);
  sequence._buffer = static_cast<decltype(sequence._buffer)>(const_cast<void*>(bytes));
  return sequence;
}

Result<int> open_writer(dds_entity_t participant, const dds_topic_descriptor_t& type, const std::string& ros_name,
                        const std::string& type_hash, bool best_effort) {
  if (ros_name.size() < 2 || ros_name[0] != '/')
    return fail(ErrorCode::dds_failed, "a ROS topic name begins with a slash: " + ros_name);
  const std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)> qos(dds_create_qos(), &dds_delete_qos);
  dds_qset_reliability(qos.get(), best_effort ? DDS_RELIABILITY_BEST_EFFORT : DDS_RELIABILITY_RELIABLE, DDS_MSECS(100));
  dds_qset_durability(qos.get(), DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, 5);
  const dds_data_representation_id_t xcdr1 = DDS_DATA_REPRESENTATION_XCDR1;
  dds_qset_data_representation(qos.get(), 1, &xcdr1);
  const std::string user_data = "typehash=RIHS01_" + type_hash + ";";
  dds_qset_userdata(qos.get(), user_data.data(), user_data.size());

  const dds_entity_t topic = dds_create_topic(participant, &type, ("rt" + ros_name).c_str(), qos.get(), nullptr);
  if (topic < 0) return dds_failed("topic " + ros_name, topic);
  const dds_entity_t writer = dds_create_writer(participant, topic, qos.get(), nullptr);
  if (writer < 0) return dds_failed("writer of " + ros_name, writer);
  return writer;
}

Result<void> write(int writer, const void* sample) {
  // A slow reliable reader costs it samples, as it would on a vehicle; the drive goes on.
  if (const dds_return_t code = dds_write(writer, sample); code < 0 && code != DDS_RETCODE_TIMEOUT)
    return dds_failed("write", code);
  return {};
}

sensor_msgs_msg_dds__Image_ picture(const Camera& camera, const char* encoding, const void* pixels,
                                    std::size_t bytes_per_pixel) {
  sensor_msgs_msg_dds__Image_ message{};
  message.height = static_cast<std::uint32_t>(camera.height());
  message.width = static_cast<std::uint32_t>(camera.width());
  message.step = static_cast<std::uint32_t>(message.width * bytes_per_pixel);
  message.encoding = const_cast<char*>(encoding);
  message.data = borrowed<decltype(message.data)>(pixels, std::size_t{message.step} * message.height);
  return message;
}

Result<void> publish_image(int writer, const Image& image, const char* frame) {
  sensor_msgs_msg_dds__Image_ message{};
  message.header = header(image.stamp, frame);
  message.height = static_cast<std::uint32_t>(image.height);
  message.width = message.step = static_cast<std::uint32_t>(image.width);
  message.encoding = const_cast<char*>("mono8");
  message.data = borrowed<decltype(message.data)>(image.pixels.data(), image.pixels.size());
  return write(writer, &message);
}

}  // namespace

Result<Publisher> Publisher::open(const PublisherOptions& options, const Vehicle& vehicle) {
  const bool plain = std::ranges::all_of(options.interface, [](char c) {
    return std::isalnum(static_cast<unsigned char>(c)) || std::string_view("._:-@").find(c) != std::string_view::npos;
  });
  if (options.interface.empty() || !plain)
    return fail(ErrorCode::dds_failed, "not a network interface: " + options.interface);
  const std::string configuration = "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name=\"" +
                                    options.interface +
                                    "\" multicast=\"true\"/></Interfaces></General></Domain></CycloneDDS>";
  Publisher publisher(vehicle);
  publisher.depth_as_ = options.depth_as;
  publisher.motion_as_ = options.motion_as;
  const dds_entity_t domain = dds_create_domain(static_cast<dds_domainid_t>(options.domain), configuration.c_str());
  if (domain < 0) return dds_failed("domain " + std::to_string(options.domain) + " on " + options.interface, domain);
  publisher.domain_ = domain;
  const dds_entity_t participant =
      dds_create_participant(static_cast<dds_domainid_t>(options.domain), nullptr, nullptr);
  if (participant < 0) return dds_failed("participant on " + options.interface, participant);

  struct Wanted {
    int& writer;
    const dds_topic_descriptor_t& type;
    const std::string& name;
    const char* hash;
  };
  const bool disparity = options.depth_as == DepthAs::disparity, imu = options.motion_as == MotionAs::imu;
  const Topics& topics = options.topics;
  for (const Wanted& wanted :
       {Wanted{publisher.left_, sensor_msgs_msg_dds__Image__desc, topics.left_image, image_hash},
        Wanted{publisher.right_, sensor_msgs_msg_dds__Image__desc, topics.right_image, image_hash},
        Wanted{publisher.left_info_, sensor_msgs_msg_dds__CameraInfo__desc, topics.left_info, camera_info_hash},
        Wanted{publisher.right_info_, sensor_msgs_msg_dds__CameraInfo__desc, topics.right_info, camera_info_hash},
        Wanted{publisher.cloud_, sensor_msgs_msg_dds__PointCloud2__desc, topics.cloud, point_cloud_hash},
        Wanted{publisher.depth_,
               disparity ? stereo_msgs_msg_dds__DisparityImage__desc : sensor_msgs_msg_dds__Image__desc, topics.depth,
               disparity ? disparity_hash : image_hash},
        Wanted{publisher.motion_, imu ? sensor_msgs_msg_dds__Imu__desc : nav_msgs_msg_dds__Odometry__desc,
               topics.motion, imu ? imu_hash : odometry_hash}}) {
    if (wanted.name.empty() && (&wanted.writer == &publisher.depth_ || &wanted.writer == &publisher.motion_)) continue;
    if (vehicle.baseline_m == 0 && (&wanted.writer == &publisher.right_ || &wanted.writer == &publisher.right_info_))
      continue;
    const auto writer = open_writer(participant, wanted.type, wanted.name, wanted.hash, options.best_effort);
    if (!writer) return propagate(writer);
    wanted.writer = *writer;
  }
  return publisher;
}

Publisher::Publisher(Publisher&& other) noexcept
    : domain_(std::exchange(other.domain_, 0)),
      left_(other.left_),
      right_(other.right_),
      left_info_(other.left_info_),
      right_info_(other.right_info_),
      cloud_(other.cloud_),
      depth_(other.depth_),
      motion_(other.motion_),
      depth_as_(other.depth_as_),
      motion_as_(other.motion_as_),
      vehicle_(std::move(other.vehicle_)) {}

Publisher::~Publisher() {
  if (domain_ != 0) dds_delete(domain_);
}

Result<void> Publisher::publish(const Image& left, const std::optional<Image>& right) {
  if (const auto info = publish_info(left_info_, left.stamp, 0, vehicle_.R_rectified_left); !info) return info;
  if (!right) return publish_image(left_, left, "camera_left");
  if (const auto info = publish_info(right_info_, right->stamp, vehicle_.baseline_m, vehicle_.R_rectified_right); !info)
    return info;
  if (const auto image = publish_image(left_, left, "camera_left"); !image) return image;
  return publish_image(right_, *right, "camera_right");
}

Result<void> Publisher::publish_depth(Timestamp stamp, const std::vector<float>& depth_m) {
  if (depth_ == 0) return {};
  if (depth_m.empty()) return fail(ErrorCode::no_depth, "a recorded drive has no true depth; leave out --depth-topic");
  const Camera& camera = vehicle_.camera;
  std::vector<float> values(depth_m);
  std::vector<std::uint16_t> millimetres;
  if (depth_as_ == DepthAs::millimetres) {
    for (const float metres : depth_m)
      millimetres.push_back(metres < 65.5F ? static_cast<std::uint16_t>(std::lround(1000 * metres)) : 0);
    auto message = picture(camera, "16UC1", millimetres.data(), sizeof millimetres.front());
    message.header = header(stamp, "camera_left");
    return write(depth_, &message);
  }
  if (depth_as_ == DepthAs::metres) {
    auto message = picture(camera, "32FC1", values.data(), sizeof values.front());
    message.header = header(stamp, "camera_left");
    return write(depth_, &message);
  }
  const auto scale = static_cast<float>(camera.fx() * vehicle_.baseline_m);
  for (float& value : values) value = scale / value;
  stereo_msgs_msg_dds__DisparityImage_ message{};
  message.header = header(stamp, "camera_left");
  message.image = picture(camera, "32FC1", values.data(), sizeof values.front());
  message.image.header = message.header;
  message.f = static_cast<float>(camera.fx());
  message.t = static_cast<float>(vehicle_.baseline_m);
  message.min_disparity = 0.5F;
  message.max_disparity = static_cast<float>(camera.width());
  message.delta_d = 1.0F / 16;
  return write(depth_, &message);
}

Result<void> Publisher::publish_motion(Timestamp stamp, const Eigen::Vector3d& angular_velocity_rad_s) {
  if (motion_ == 0) return {};
  const Eigen::Vector3d& w = angular_velocity_rad_s;
  if (motion_as_ == MotionAs::odometry) {
    nav_msgs_msg_dds__Odometry_ message{};
    message.header = header(stamp, "odom");
    message.child_frame_id = const_cast<char*>("base_link");
    message.twist.twist.angular = {w.x(), w.y(), w.z()};
    return write(motion_, &message);
  }
  sensor_msgs_msg_dds__Imu_ message{};
  message.header = header(stamp, "imu");
  message.angular_velocity = {w.x(), w.y(), w.z()};
  // By convention: not measured.
  message.orientation_covariance[0] = message.linear_acceleration_covariance[0] = -1;
  return write(motion_, &message);
}

Result<void> Publisher::publish_info(int writer, Timestamp stamp, double baseline_m,
                                     const Eigen::Matrix3d& R_rectified_camera) {
  const Camera& camera = vehicle_.camera;
  sensor_msgs_msg_dds__CameraInfo_ message{};
  // By convention both cameras of a rectified pair are expressed in the left one's frame.
  message.header = header(stamp, "camera_left");
  message.height = static_cast<std::uint32_t>(camera.height());
  message.width = static_cast<std::uint32_t>(camera.width());
  const auto model = std::ranges::find(all_camera_models, camera.model(), &CameraModelFacts::model);
  const bool has_lens = camera.model() != CameraModel::rectified && model->ros;
  const std::string name(has_lens ? model->ros->name : "plumb_bob");
  message.distortion_model = const_cast<char*>(name.c_str());  // read only
  std::vector<double> distortion = camera.distortion();
  if (!has_lens) distortion.resize(5);
  message.d = borrowed<decltype(message.d)>(distortion.data(), distortion.size());
  message.k[0] = message.p[0] = camera.fx();
  message.k[2] = message.p[2] = camera.cx();
  message.k[4] = message.p[5] = camera.fy();
  message.k[5] = message.p[6] = camera.cy();
  message.k[8] = message.p[10] = 1;
  Eigen::Map<Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(message.r) = R_rectified_camera;
  message.p[3] = -camera.fx() * baseline_m;
  return write(writer, &message);
}

Result<void> Publisher::publish(const LidarScan& scan) {
  constexpr std::uint8_t float32 = 7;
  static_assert(sizeof(LidarPoint) == 16);
  const auto field = [](const char* name, std::uint32_t offset) {
    return sensor_msgs_msg_dds__PointField_{const_cast<char*>(name), offset, float32, 1};
  };
  const std::array<sensor_msgs_msg_dds__PointField_, 4> fields{field("x", 0), field("y", 4), field("z", 8),
                                                               field("intensity", 12)};
  sensor_msgs_msg_dds__PointCloud2_ message{};
  message.header = header(scan.stamp, "lidar");
  message.height = 1;
  message.width = static_cast<std::uint32_t>(scan.points.size());
  message.fields = borrowed<decltype(message.fields)>(fields.data(), fields.size());
  message.point_step = sizeof(LidarPoint);
  message.row_step = message.width * message.point_step;
  message.data = borrowed<decltype(message.data)>(scan.points.data(), scan.points.size() * sizeof(LidarPoint));
  message.is_dense = true;
  return write(cloud_, &message);
}

}  // namespace calib::vehicle
