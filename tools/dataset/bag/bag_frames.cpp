#include "dataset/bag/bag_frames.hpp"

#include <utility>

#include "dataset/bag/ros_message.hpp"

namespace calib {

Result<Image> image_in(Octets bytes, const BagTopic& topic, Colour colour, const ImageBound& bound) {
  if (topic.is(bag_type::compressed_image))
    return RosMessage::read(std::move(bytes), compressed_image_type).and_then([&](const RosMessage& message) {
      return decode_compressed_image(message.as<sensor_msgs_msg_dds__CompressedImage_>(), colour, bound);
    });
  return RosMessage::read(std::move(bytes), image_type).and_then([&](const RosMessage& message) {
    return decode_image(message.as<sensor_msgs_msg_dds__Image_>(), colour, bound);
  });
}

Result<DepthImage> depth_in(Octets bytes, const BagTopic& topic, const ImageBound& bound) {
  if (topic.is(bag_type::disparity))
    return RosMessage::read(std::move(bytes), disparity_image_type).and_then([&](const RosMessage& message) {
      return decode_disparity(message.as<stereo_msgs_msg_dds__DisparityImage_>(), bound);
    });
  return RosMessage::read(std::move(bytes), image_type).and_then([&](const RosMessage& message) {
    return decode_depth(message.as<sensor_msgs_msg_dds__Image_>(), bound);
  });
}

Result<DecodedCloud> cloud_in(Octets bytes) {
  return RosMessage::read(std::move(bytes), cloud_type).and_then([](const RosMessage& message) {
    return decode_cloud(message.as<sensor_msgs_msg_dds__PointCloud2_>());
  });
}

Result<CameraInfo> info_in(Octets bytes) {
  return RosMessage::read(std::move(bytes), camera_info_type).and_then([](const RosMessage& message) {
    return decode_camera_info(message.as<sensor_msgs_msg_dds__CameraInfo_>());
  });
}

Result<FramePair> BagFrames::read(std::size_t index, Colour colour) const {
  const RecordedPair& pair = pairs.pairs[index];
  const auto bytes = [this](const BagStream& stream, const StampedMessage& message) {
    return bag->read(stream.messages[message.number]);
  };
  const auto image_of = [&](const BagStream& stream, const StampedMessage& message, Colour wanted) {
    return bytes(stream, message).and_then([&](Octets read) {
      return image_in(std::move(read), stream.topic, wanted, stream.bound);
    });
  };
  auto image = image_of(images, pair.image, colour);
  if (!image) return propagate(image);
  auto scan = bytes(scans, pair.scan).and_then(cloud_in);
  if (!scan) return propagate(scan);
  if (scan->points.empty())
    return fail(ErrorCode::cloud_empty, "the cloud of " + stamp_name(scan->stamp) + " holds no point");
  FramePair frame{*std::move(image), std::nullopt, static_cast<LidarScan&&>(*std::move(scan))};
  if (pair.right_image) {
    auto right = image_of(right_images, *pair.right_image, Colour::none);
    if (!right) return propagate(right);
    frame.right_image = *std::move(right);
  }
  if (pair.depth) {
    auto depth = bytes(depths, *pair.depth).and_then([&](Octets read) {
      return depth_in(std::move(read), depths.topic, depths.bound);
    });
    if (!depth) return propagate(depth);
    frame.depth = *std::move(depth);
  }
  return frame;
}

}  // namespace calib
