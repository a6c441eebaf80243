#include "dataset/bag/frame_pairs.hpp"

#include <algorithm>
#include <map>

namespace calib {
namespace {

/// Up to six of them about a time: as many as `PairBuffer` keeps.
StampedMessages around(const StampedMessages& samples, Timestamp time) {
  const auto after = std::ranges::lower_bound(samples, time, {}, &StampedMessage::stamp);
  const auto begin = after - std::min<std::ptrdiff_t>(3, after - samples.begin());
  return {begin, after + std::min<std::ptrdiff_t>(3, samples.end() - after)};
}

std::size_t number_at(const StampedMessages& samples, Timestamp stamp) {
  return std::ranges::lower_bound(samples, stamp, {}, &StampedMessage::stamp)->number;
}

std::string span_of(const StampedMessages& samples) {
  return std::to_string(samples.size()) + " from " + stamp_name(samples.front().stamp) + " to " +
         stamp_name(samples.back().stamp);
}

}  // namespace

std::string stamp_name(Timestamp stamp) { return std::to_string(stamp.count()); }

RecordedPairs pair_by_stamp(const StampedMessages& images, const StampedMessages& scans,
                            const StampedMessages* right_images, const StampedMessages* depths,
                            std::chrono::nanoseconds tolerance) {
  const bool by_image = images.size() <= scans.size();
  const Companions companions{.right_image = right_images != nullptr, .depth = depths != nullptr};
  std::map<Timestamp, RecordedPair> by_partner;  // of the more numerous kind: no sample twice
  std::map<Timestamp, Error> without;
  for (const StampedMessage& sample : by_image ? images : scans) {
    PairBuffer buffer(tolerance, companions);
    for (const StampedMessage& image : by_image ? StampedMessages{sample} : around(images, sample.stamp)) {
      buffer.add_image({.stamp = image.stamp, .pixels = {}});
      // The nearest ones of each image are certainly among these.
      if (right_images != nullptr)
        for (const StampedMessage& right : around(*right_images, image.stamp))
          if (std::chrono::abs(right.stamp - image.stamp) <= PairBuffer::trigger_tolerance)
            buffer.add_right_image({.stamp = right.stamp, .pixels = {}});
      if (depths != nullptr)
        for (const StampedMessage& depth : around(*depths, image.stamp))
          if (std::chrono::abs(depth.stamp - image.stamp) <= PairBuffer::trigger_tolerance)
            buffer.add_depth({.stamp = depth.stamp, .inverse_depth = {}});
    }
    for (const StampedMessage& scan : by_image ? around(scans, sample.stamp) : StampedMessages{sample})
      buffer.add_scan({.stamp = scan.stamp, .points = {}});
    const auto pair = buffer.take();
    if (!pair) {
      without.emplace(sample.stamp, buffer.why_none());
      continue;
    }
    RecordedPair found{{pair->image.stamp, number_at(images, pair->image.stamp)},
                       {pair->scan.stamp, number_at(scans, pair->scan.stamp)},
                       {},
                       {}};
    if (pair->right_image)
      found.right_image = {pair->right_image->stamp, number_at(*right_images, pair->right_image->stamp)};
    if (pair->depth) found.depth = {pair->depth->stamp, number_at(*depths, pair->depth->stamp)};
    const Timestamp partner = by_image ? found.scan.stamp : found.image.stamp;
    const auto apart = [](const RecordedPair& p) { return std::chrono::abs(p.scan.stamp - p.image.stamp); };
    const auto [place, is_new] = by_partner.try_emplace(partner, found);
    if (is_new) continue;
    // Of two that want the same partner, the nearer one has it.
    const bool nearer = apart(found) < apart(place->second);
    const RecordedPair& loser = nearer ? place->second : found;
    without.emplace(by_image ? loser.image.stamp : loser.scan.stamp,
                    Error{ErrorCode::no_pair, "its nearest partner belongs to another one"});
    if (nearer) place->second = found;
  }

  RecordedPairs result;
  for (const auto& [partner, pair] : by_partner) result.pairs.push_back(pair);
  std::ranges::sort(result.pairs, {}, [](const RecordedPair& pair) { return pair.image.stamp; });
  for (const auto& [stamp, error] : without) {
    const char* missing = error.code == ErrorCode::right_image_missing ? "no right image"
                          : error.code == ErrorCode::depth_missing     ? "no depth"
                          : by_image                                   ? "no cloud"
                                                                       : "no image";
    result.lacks.push_back(std::string(missing) + " for " + stamp_name(stamp));
  }
  if (result.pairs.empty() && (images.empty() || scans.empty()))
    result.why_none = "their messages have no stamps";
  else if (result.pairs.empty())
    result.why_none =
        without.begin()->second.context + " (images: " + span_of(images) + " ns, clouds: " + span_of(scans) + " ns)";
  return result;
}

}  // namespace calib
