#pragma once

#include <memory>

#include "dataset/bag/bag.hpp"
#include "dataset/bag/frame_pairs.hpp"
#include "dds/decode.hpp"

namespace calib {

// The bytes of a message, decoded by calibd's own decoders. They fail as those do, and with `malformed:refused`.

/// Image or CompressedImage.
[[nodiscard]] Result<Image> image_in(Octets bytes, const BagTopic& topic, Colour colour, const ImageBound& bound);
/// Image of depth, or DisparityImage.
[[nodiscard]] Result<DepthImage> depth_in(Octets bytes, const BagTopic& topic, const ImageBound& bound);
[[nodiscard]] Result<DecodedCloud> cloud_in(Octets bytes);
[[nodiscard]] Result<CameraInfo> info_in(Octets bytes);

/// Samples of one topic.
struct BagStream {
  BagTopic topic;
  Bag::Messages messages;
  ImageBound bound = {};
};

/// The frames of a recording: which messages, and how they are read.
struct BagFrames {
  std::shared_ptr<const Bag> bag;
  BagStream images, scans, right_images, depths;
  RecordedPairs pairs;

  /// From any thread. Fails as the decoders do, and with `file_unreadable` or `cloud_empty`.
  [[nodiscard]] Result<FramePair> read(std::size_t index, Colour colour) const;
};

}  // namespace calib
