#include "calib/pairing.hpp"

#include <algorithm>
#include <string>

namespace calib {
namespace {

template <typename Sample>
void add_bounded(std::deque<Sample>& samples, Sample sample, std::size_t capacity) {
  samples.push_back(std::move(sample));
  if (samples.size() > capacity) samples.pop_front();
}

/// The sample nearest in time, wherever it stands: order of arrival is not order of stamps.
template <typename Sample>
auto nearest(std::deque<Sample>& samples, Timestamp stamp) {
  return std::ranges::min_element(
      samples, {}, [&](const Sample& sample) { return std::chrono::abs(sample.stamp - stamp); });
}

template <typename Sample>
void drop_until(std::deque<Sample>& samples, Timestamp stamp) {
  std::erase_if(samples, [&](const Sample& sample) { return sample.stamp <= stamp; });
}

}  // namespace

PairBuffer::PairBuffer(std::chrono::nanoseconds max_time_difference, bool with_right_image)
    : max_time_difference_(max_time_difference), with_right_image_(with_right_image) {}

void PairBuffer::add_image(Image image) { add_bounded(images_, std::move(image), capacity); }
void PairBuffer::add_right_image(Image image) { add_bounded(right_images_, std::move(image), capacity); }
void PairBuffer::add_scan(LidarScan scan) { add_bounded(scans_, std::move(scan), capacity); }

std::optional<FramePair> PairBuffer::take() {
  auto best_image = images_.end();
  auto best_difference = max_time_difference_;
  if (scans_.empty()) return std::nullopt;
  for (auto image = images_.begin(); image != images_.end(); ++image) {
    if (with_right_image_) {
      const auto right = nearest(right_images_, image->stamp);
      if (right == right_images_.end() || std::chrono::abs(right->stamp - image->stamp) > stereo_tolerance) continue;
    }
    const auto difference = std::chrono::abs(nearest(scans_, image->stamp)->stamp - image->stamp);
    if (difference <= best_difference) {
      best_difference = difference;
      best_image = image;
    }
  }
  if (best_image == images_.end()) return std::nullopt;

  FramePair pair;
  pair.scan = std::move(*nearest(scans_, best_image->stamp));
  if (with_right_image_) pair.right_image = std::move(*nearest(right_images_, best_image->stamp));
  pair.image = std::move(*best_image);
  drop_until(scans_, pair.scan.stamp);
  drop_until(right_images_, pair.image.stamp + stereo_tolerance);
  drop_until(images_, pair.image.stamp);
  return pair;
}

Error PairBuffer::why_none() const {
  if (images_.empty()) return {"sensor_silent", "no image arrived; is the camera's driver running, and the topic right?"};
  if (scans_.empty()) return {"sensor_silent", "no point cloud arrived; is the LiDAR's driver running, and the topic right?"};
  if (with_right_image_ && right_images_.empty())
    return {"right_image_missing", "no right image arrived; is the right camera's driver running, and the topic right?"};
  auto smallest = std::chrono::nanoseconds::max();
  for (const Image& image : images_)
    for (const LidarScan& scan : scans_) smallest = std::min(smallest, std::chrono::abs(scan.stamp - image.stamp));
  if (smallest <= max_time_difference_)
    return {"right_image_missing", "no right image has the stamp of a left one (within 5 ms); are they triggered together?"};
  return {"time_difference",
          "image and point cloud are at least " +
              std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(smallest).count()) +
              " ms apart; are the sensors' clocks synchronised?"};
}

}  // namespace calib
