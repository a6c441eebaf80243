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
auto nearest(auto& samples, Timestamp stamp) {
  return std::ranges::min_element(samples, {},
                                  [&](const auto& sample) { return std::chrono::abs(sample.stamp - stamp); });
}

bool has_one_at(const auto& samples, Timestamp stamp) {
  const auto sample = nearest(samples, stamp);
  return sample != samples.end() && std::chrono::abs(sample->stamp - stamp) <= PairBuffer::trigger_tolerance;
}

template <typename Sample>
void drop_until(std::deque<Sample>& samples, Timestamp stamp) {
  std::erase_if(samples, [&](const Sample& sample) { return sample.stamp <= stamp; });
}

}  // namespace

PairBuffer::PairBuffer(std::chrono::nanoseconds max_time_difference, Companions companions)
    : max_time_difference_(max_time_difference), companions_(companions) {}

void PairBuffer::add_image(Image image) { add_bounded(images_, std::move(image), capacity); }
void PairBuffer::add_right_image(Image image) { add_bounded(right_images_, std::move(image), capacity); }
void PairBuffer::add_depth(DepthImage depth) { add_bounded(depths_, std::move(depth), capacity); }
void PairBuffer::add_scan(LidarScan scan) { add_bounded(scans_, std::move(scan), capacity); }
void PairBuffer::add_turn_rate(TurnRate rate) { add_bounded(turn_rates_, rate, turn_rate_capacity); }

bool PairBuffer::has_companions(Timestamp stamp) const {
  return (!companions_.right_image || has_one_at(right_images_, stamp)) &&
         (!companions_.depth || has_one_at(depths_, stamp));
}

std::optional<double> PairBuffer::largest_turn_rate(Timestamp from, Timestamp to) const {
  Timestamp first = Timestamp::min(), last = Timestamp::max();  // the samples next to both stamps, from outside
  for (const TurnRate& rate : turn_rates_) {
    if (rate.stamp <= from) first = std::max(first, rate.stamp);
    if (rate.stamp >= to) last = std::min(last, rate.stamp);
  }
  if (first < from - turn_rate_tolerance || last > to + turn_rate_tolerance) return std::nullopt;
  double largest = 0;
  for (const TurnRate& rate : turn_rates_)
    if (rate.stamp >= first && rate.stamp <= last) largest = std::max(largest, rate.rate_rad_s);
  return largest;
}

std::optional<FramePair> PairBuffer::take() {
  auto best_image = images_.end();
  auto best_difference = max_time_difference_;
  std::optional<double> turn_rate;
  if (scans_.empty()) return std::nullopt;
  for (auto image = images_.begin(); image != images_.end(); ++image) {
    if (!has_companions(image->stamp)) continue;
    const auto [from, to] = std::minmax({image->stamp, nearest(scans_, image->stamp)->stamp});
    if (to - from > best_difference) continue;
    const auto rate = companions_.turn_rate ? largest_turn_rate(from, to) : std::nullopt;
    if (companions_.turn_rate && !rate) continue;
    best_difference = to - from;
    best_image = image;
    turn_rate = rate;
  }
  if (best_image == images_.end()) return std::nullopt;

  FramePair pair;
  pair.turn_rate_rad_s = turn_rate;
  pair.scan = std::move(*nearest(scans_, best_image->stamp));
  if (companions_.right_image) pair.right_image = std::move(*nearest(right_images_, best_image->stamp));
  if (companions_.depth) pair.depth = std::move(*nearest(depths_, best_image->stamp));
  pair.image = std::move(*best_image);
  drop_until(scans_, pair.scan.stamp);
  drop_until(right_images_, pair.image.stamp + trigger_tolerance);
  drop_until(depths_, pair.image.stamp + trigger_tolerance);
  drop_until(images_, pair.image.stamp);
  return pair;
}

Error PairBuffer::why_none() const {
  if (images_.empty())
    return {ErrorCode::sensor_silent, "no image arrived; is the camera's driver running, and the topic right?"};
  if (scans_.empty())
    return {ErrorCode::sensor_silent, "no point cloud arrived; is the LiDAR's driver running, and the topic right?"};
  if (companions_.right_image && right_images_.empty())
    return {ErrorCode::right_image_missing,
            "no right image arrived; is the right camera's driver running, and the topic right?"};
  if (companions_.depth && depths_.empty())
    return {ErrorCode::depth_missing, "no depth arrived; is what makes it running, and the topic right?"};
  if (companions_.turn_rate && std::ranges::any_of(images_, [&](const Image& image) {
        const auto difference = std::chrono::abs(nearest(scans_, image.stamp)->stamp - image.stamp);
        return has_companions(image.stamp) && difference <= max_time_difference_;
      }))
    return {ErrorCode::motion_unknown,
            turn_rates_.empty()
                ? "no turn rate arrived; is what publishes motion.topic running, and the topic right?"
                : "no turn rate was measured within 150 ms before and after a pair; is motion.topic published at 10 Hz "
                  "or more, and are the clocks synchronised?"};
  auto smallest = std::chrono::nanoseconds::max();
  for (const Image& image : images_)
    for (const LidarScan& scan : scans_) smallest = std::min(smallest, std::chrono::abs(scan.stamp - image.stamp));
  if (smallest <= max_time_difference_) {
    const bool no_right = companions_.right_image && std::ranges::none_of(images_, [&](const Image& image) {
                            return has_one_at(right_images_, image.stamp);
                          });
    if (no_right || !companions_.depth)
      return {ErrorCode::right_image_missing,
              "no right image has the stamp of a left one (within 5 ms); are they triggered together?"};
    return {ErrorCode::depth_missing,
            "no depth has the stamp of an image (within 5 ms); is it made of this camera's images?"};
  }
  return {ErrorCode::time_difference,
          "image and point cloud are at least " +
              std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(smallest).count()) +
              " ms apart; are the sensors' clocks synchronised?"};
}

}  // namespace calib
