#pragma once

#include <memory>
#include <span>
#include <string>

#include "calib/status.hpp"
#include "calibd.h"
#include "dds/entity.hpp"
#include "drift_alert.hpp"
#include "ros2.h"

namespace calib {

// Descriptor and type hash of every message that calibd reads or writes. The hashes are the same from ROS 2 Humble to
// Kilted.
inline const MessageType image_type{&sensor_msgs_msg_dds__Image__desc,
                                    "d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47"};
inline const MessageType compressed_image_type{&sensor_msgs_msg_dds__CompressedImage__desc,
                                               "15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a"};
inline const MessageType disparity_image_type{&stereo_msgs_msg_dds__DisparityImage__desc,
                                              "1ec1ff6b5bace919e4544a37f2d96ead9f81783701b7b7a4d97a09325ecf2711"};
inline const MessageType camera_info_type{&sensor_msgs_msg_dds__CameraInfo__desc,
                                          "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275"};
inline const MessageType cloud_type{&sensor_msgs_msg_dds__PointCloud2__desc,
                                    "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5"};
inline const MessageType imu_type{&sensor_msgs_msg_dds__Imu__desc,
                                  "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b"};
inline const MessageType odometry_type{&nav_msgs_msg_dds__Odometry__desc,
                                       "3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0"};
inline const MessageType diagnostics_type{&diagnostic_msgs_msg_dds__DiagnosticArray__desc,
                                          "5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e"};
inline const MessageType transforms_type{&tf2_msgs_msg_dds__TFMessage__desc,
                                         "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087"};
inline const MessageType drift_alert_type{&calibd_msgs_msg_dds__DriftAlert__desc,
                                          "fcba5c1a50cfc166e7cc573626b7eae80488aee377f42ca5ae0cc7763019899a"};

/// A computed extrinsic, published for other programs: the LiDAR's frame is the child of the camera's optical frame.
struct ProposedExtrinsic {
  std::string camera_frame;
  std::string lidar_frame;
  RigidTransform T_camera_lidar = RigidTransform::Identity();
};

/// Frees a message together with its strings and sequences, which Cyclone allocated.
template <typename Message, const dds_topic_descriptor_t& descriptor>
struct FreeMessage {
  void operator()(Message* message) const { dds_sample_free(message, &descriptor, DDS_FREE_ALL); }
};
template <typename Message, const dds_topic_descriptor_t& descriptor>
using Owned = std::unique_ptr<Message, FreeMessage<Message, descriptor>>;

using DiagnosticArrayMessage =
    Owned<diagnostic_msgs_msg_dds__DiagnosticArray_, diagnostic_msgs_msg_dds__DiagnosticArray__desc>;
using TransformsMessage = Owned<tf2_msgs_msg_dds__TFMessage_, tf2_msgs_msg_dds__TFMessage__desc>;
using DriftAlertMessage = Owned<calibd_msgs_msg_dds__DriftAlert_, calibd_msgs_msg_dds__DriftAlert__desc>;

/// One DiagnosticStatus per pair. Its level is OK if calibrated, WARN if suspect, ERROR if drifted, STALE if not
/// evaluated. Values are for people: in degrees and centimetres, with the unit at the end of the key.
[[nodiscard]] DiagnosticArrayMessage diagnostics_message(const Status& status, WallTime now);
[[nodiscard]] TransformsMessage transforms_message(std::span<const ProposedExtrinsic> proposed, WallTime now);
[[nodiscard]] DriftAlertMessage drift_alert_message(const DriftAlert& alert);

}  // namespace calib
