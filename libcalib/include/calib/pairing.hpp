#pragma once

#include <deque>
#include <optional>

#include "calib/frame.hpp"

namespace calib {

/// What a pair needs beside image and scan.
struct Companions {
  bool right_image = false;
  bool depth = false;
  bool turn_rate = false;
};

/// Finds the image and the scan that belong together among samples that arrive in any order.
/// Bounded: of each kind only the latest few are kept, so a silent sensor costs no memory.
class PairBuffer {
 public:
  /// Companions belong to an image when their stamps differ by no more than this. A stereo camera has one trigger, and
  /// depth computed from an image has the image's stamp. Depth of another moment is wrong where the vehicle moves: 5 ms
  /// are 15 cm at 30 m/s.
  static constexpr std::chrono::milliseconds trigger_tolerance{5};

  /// A pair's turn rate is known when it was measured no longer than this before the earlier stamp and no longer than
  /// this after the later one: it is the largest of those two and all in between. So odometry of 10 Hz, a little late,
  /// is sufficient, and a turn that begins or ends between two samples is covered.
  static constexpr std::chrono::milliseconds turn_rate_tolerance{150};

  PairBuffer(std::chrono::nanoseconds max_time_difference, Companions companions);

  void add_image(Image image);
  void add_right_image(Image image);
  void add_depth(DepthImage depth);
  void add_scan(LidarScan scan);
  void add_turn_rate(TurnRate rate);

  /// The pair with the smallest time difference within the tolerance, or nothing yet. Its samples, and all older ones,
  /// leave the buffer.
  [[nodiscard]] std::optional<FramePair> take();

  /// Why no pair came of what has arrived so far: `sensor_silent` (and which), `right_image_missing`,
  /// `depth_missing`, `motion_unknown` or `time_difference` (and how much).
  [[nodiscard]] Error why_none() const;

 private:
  [[nodiscard]] bool has_companions(Timestamp stamp) const;
  [[nodiscard]] std::optional<double> largest_turn_rate(Timestamp from, Timestamp to) const;
  static constexpr std::size_t capacity = 6;
  static constexpr std::size_t turn_rate_capacity = 2048;  // two seconds of the fastest IMU, 32 KiB
  std::chrono::nanoseconds max_time_difference_;
  Companions companions_;
  std::deque<Image> images_;
  std::deque<Image> right_images_;
  std::deque<DepthImage> depths_;
  std::deque<LidarScan> scans_;
  std::deque<TurnRate> turn_rates_;
};

}  // namespace calib
