#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "calib/pairing.hpp"
#include "pair_watch.hpp"
#include "support/support.hpp"
#include "vehicle/vehicle.hpp"

namespace calib::test {

/// What the simulated vehicle's sensors saw on its way around the block, and what its stereo camera makes of it: made
/// once for all scenarios of a program, which drive around it again and again.
struct Block {
  static constexpr int frames = 48;
  /// A KITTI raw drive to be used instead of the simulated one; to be set before anything else.
  static inline std::filesystem::path recording;

  vehicle::Vehicle vehicle;
  std::vector<FramePair> seen;
  std::vector<DepthMap> depth;

  [[nodiscard]] static const Block& instance();

 private:
  void see();
};

/// What befalls the vehicle while it drives.
struct World {
  Vector6 motion = Vector6::Zero();        // how far the LiDAR has moved, in its own frame
  bool camera = true, lidar = true;        // whether they send
  bool frozen = false;                     // the camera sends the same image again and again, with new stamps
  std::chrono::nanoseconds lidar_clock{};  // is ahead
  std::function<void(FramePair&)> samples = nullptr;  // changes what the sensors send
  std::function<void(DepthMap&)> depth = nullptr;     // changes what the stereo camera makes of it
};

/// A LiDAR that has turned (degrees) and gone (cm).
[[nodiscard]] Vector6 moved(double roll_deg, double pitch_deg, double yaw_deg, double x_cm = 0, double y_cm = 0,
                            double z_cm = 0);

/// One pair of sensors, watched as calibd does: the simulated vehicle's samples, put together, evaluated and decided
/// about by the real parts, with a real ledger in a temporary folder; a pair every ten seconds of a clock of its own.
class PairScenario {
 public:
  struct Settings {
    RecalibrationMode mode = RecalibrationMode::apply;
    Vector6 wrong_from_start = Vector6::Zero();  // how far off the configured extrinsic is
    /// Begins when the extrinsic's baseline has been learned, from as many pairs as it ever is.
    bool learned = true;
  };
  PairScenario() : PairScenario(Settings{}) {}
  explicit PairScenario(const Settings& settings);
  ~PairScenario();

  /// The world after so many hours of the present drive.
  using Course = std::function<World(double hours)>;
  /// So many windows of sampling.
  void drive(int windows, const Course& course);
  void drive(int windows, const World& world = {}) {
    drive(windows, [&](double) { return world; });
  }
  /// Windows until the verdict is this one, `most` + 1 when it has not come by then.
  int drive_until(Verdict verdict, int most, const Course& course);
  int drive_until(Verdict verdict, int most, const World& world = {}) {
    return drive_until(verdict, most, [&](double) { return world; });
  }
  /// What a frame of the block shows in this world to a pair that still learns, and a window in which just that comes.
  [[nodiscard]] PairMonitor::Evidence measure(int frame, const World& world);
  void observe(PairMonitor::Evidence evidence);
  /// calibd ends and starts again. `sql` is done to its store in between; with another digest it measures with
  /// something else from then on.
  void restart(const std::string& sql = "", const std::string& evidence_sha256 = "");
  /// What the control socket answers: "accepted", or why not.
  std::string accept(const std::string& asked_by);
  std::string roll_back(std::optional<std::uint64_t> to_record, const std::string& asked_by);
  /// Leaves a copy of the store and its key in `folder`.
  void save(const std::filesystem::path& folder);

  /// Since the beginning of the scenario; what happened while the baseline was learned is not counted.
  [[nodiscard]] int alerts(Verdict verdict) const;
  [[nodiscard]] int alerts() const { return static_cast<int>(alerts_.size()); }
  [[nodiscard]] int records(Decision decision) const;
  /// Of the last record with that decision.
  [[nodiscard]] std::string reason(Decision decision) const;
  [[nodiscard]] CalibrationRecord last_record() const;
  [[nodiscard]] const std::vector<std::string>& journal() const { return journal_; }

  [[nodiscard]] PairWatch& watch() { return *watch_; }
  [[nodiscard]] PairStatus status() const { return watch_->status(); }
  [[nodiscard]] Verdict verdict() const { return watch_->state().verdict; }
  [[nodiscard]] const std::string& reason() const { return watch_->state().reason; }
  [[nodiscard]] std::uint64_t skipped(const std::string& code) const;
  /// Angle, degrees, between the extrinsic in force and where a LiDAR is that has moved by `motion`.
  [[nodiscard]] double error_deg(const Vector6& motion) const;
  [[nodiscard]] const Moment& now() const { return now_; }

 private:
  class StereoCamera;
  void open();
  void sample(const World& world);
  [[nodiscard]] static FramePair samples(Timestamp stamp, const World& world);
  void pass_time();

  TemporaryFolder folder_;
  Config config_;
  std::string evidence_sha256_ = std::string(64, 'e');
  World world_;  // at present
  std::optional<Ledger> ledger_;
  std::unique_ptr<PairWatch> watch_;
  Moment now_{std::chrono::seconds(1'800'000'000), std::chrono::seconds(100)};
  int windows_ = 0;
  std::uint64_t first_record_ = 1;
  std::vector<Verdict> alerts_;
  std::vector<std::string> journal_;
};

}  // namespace calib::test
