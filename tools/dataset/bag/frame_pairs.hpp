#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include "calib/pairing.hpp"

namespace calib {

/// A sample of a recording by its stamp, and which of its topic's messages it is.
struct StampedMessage {
  Timestamp stamp{};
  std::size_t number = 0;
};
using StampedMessages = std::vector<StampedMessage>;

/// Samples that belong together: numbers of messages.
struct RecordedPair {
  StampedMessage image, scan;
  std::optional<StampedMessage> right_image, depth;
};

struct RecordedPairs {
  std::vector<RecordedPair> pairs;  // in the order of time
  /// Of images or scans, whichever are fewer, those without a partner: "no cloud for 1700000000000000000".
  std::vector<std::string> lacks;
  /// Why there is none, where there is none.
  std::string why_none;
};

/// Pairs by calibd's own rule (`PairBuffer`): each image with the scan nearest in time, within `tolerance`, or each
/// scan with the nearest image where there are fewer scans; no sample twice. Right images and depth are those of the
/// image's trigger, where they are given. All are sorted by stamp.
[[nodiscard]] RecordedPairs pair_by_stamp(const StampedMessages& images, const StampedMessages& scans,
                                          const StampedMessages* right_images, const StampedMessages* depths,
                                          std::chrono::nanoseconds tolerance);

/// Name of a frame: the image's stamp in nanoseconds. Files of depth bear it too.
[[nodiscard]] std::string stamp_name(Timestamp stamp);

}  // namespace calib
