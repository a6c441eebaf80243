#pragma once

#include <deque>
#include <optional>

#include "calib/frame.hpp"

namespace calib {

/// Finds the image and the scan that belong together among samples that arrive in any order.
/// Bounded: of each kind only the latest few are kept, so a silent sensor costs no memory.
class PairBuffer {
 public:
  /// Right images belong to a left one when their stamps differ by no more than this: a stereo camera has one trigger.
  static constexpr std::chrono::milliseconds stereo_tolerance{5};

  /// `with_right_image`: a pair is complete only with a right image.
  PairBuffer(std::chrono::nanoseconds max_time_difference, bool with_right_image);

  void add_image(Image image);
  void add_right_image(Image image);
  void add_scan(LidarScan scan);

  /// The pair with the smallest time difference within the tolerance, or nothing yet. Its samples, and all older ones,
  /// leave the buffer.
  [[nodiscard]] std::optional<FramePair> take();

  /// Why no pair came of what has arrived so far: `sensor_silent` (and which), `right_image_missing` or
  /// `time_difference` (and how much).
  [[nodiscard]] Error why_none() const;

 private:
  static constexpr std::size_t capacity = 6;
  std::chrono::nanoseconds max_time_difference_;
  bool with_right_image_;
  std::deque<Image> images_;
  std::deque<Image> right_images_;
  std::deque<LidarScan> scans_;
};

}  // namespace calib
