#pragma once

#include <optional>
#include <string>

#include "dataset/bag/bag.hpp"
#include "dataset/bag/bag_options.hpp"

namespace calib {

struct BagTopics {
  BagTopic image, cloud;
  std::optional<BagTopic> info, right_image, right_info, depth;
};

/// Fails with `bad_topic`, and with the candidates, when there is no topic or more than one for something.
[[nodiscard]] Result<BagTopics> choose_topics(const Bag& bag, const BagOptions& options);

/// Whether images of a topic are rectified, by its name: image_rect, image_rect_color, rectified/image.
[[nodiscard]] bool names_rectified_images(const std::string& topic);

/// CameraInfo of an image's topic, by convention: /camera/camera_info of /camera/image_raw; or the only one there is.
[[nodiscard]] std::optional<BagTopic> info_beside(const Bag& bag, const BagTopic& image);

/// The topics of a recording, in a line: at most 20.
[[nodiscard]] std::string list_of(const std::vector<BagTopic>& topics);

}  // namespace calib
