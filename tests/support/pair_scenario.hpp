#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "service.hpp"
#include "support/support.hpp"
#include "vehicle/vehicle.hpp"

struct sqlite3;

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
  bool repeating = false;                  // all sensors send their last samples again, with the same stamps
  std::chrono::nanoseconds lidar_clock{};  // is ahead
  std::function<void(FramePair&)> samples = nullptr;         // changes what the sensors send
  std::function<void(std::vector<Sample>&)> sent = nullptr;  // changes what arrives, or adds to it
  std::function<void(DepthMap&)> depth = nullptr;            // changes what the stereo camera makes of it
};

/// A LiDAR that has turned (degrees) and gone (cm).
[[nodiscard]] Vector6 moved(double roll_deg, double pitch_deg, double yaw_deg, double x_cm = 0, double y_cm = 0,
                            double z_cm = 0);

/// calibd's own service with one pair of sensors, in this process: the simulated vehicle's samples instead of DDS, a
/// clock of its own, a pair every ten seconds of it, and a real store in a temporary folder.
class PairScenario {
 public:
  struct Settings {
    RecalibrationMode mode = RecalibrationMode::apply;
    Vector6 wrong_from_start = Vector6::Zero();  // how far off the configured extrinsic is
    /// Begins when the extrinsic's baseline has been learned, from as many pairs as it ever is.
    bool learned = true;
    bool camera_info = false;  // whether camera.info is configured
    FrameName camera_frame{"camera_optical", "camera.frame_id"};
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
  [[nodiscard]] Measurement measure(int frame, const World& world);
  void observe(Measurement measurement);
  /// calibd ends and starts again; or it is killed, and starts again. `sql` is done to its store in between; with
  /// another text it measures with something else from then on.
  void restart(const std::string& sql = "", const std::string& evidence_text = "");
  void crash();
  /// What is asked for at the control socket.
  Result<Answer> accept() { return service_->accept(0, "uid:7"); }
  Result<Answer> roll_back(std::optional<std::uint64_t> to = {}) { return service_->roll_back(0, to, "uid:7"); }
  /// What a changed configuration file says, or why it cannot be read.
  Result<ConfigChanges> reload(Result<Config> file) {
    config_file_ = std::move(file);
    return service_->reload();
  }
  [[nodiscard]] const Config& config() const { return config_; }
  /// Another program keeps the store to itself, or lets go of it.
  void lock_store(bool locked);
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

  /// The last that were published.
  [[nodiscard]] const std::vector<ProposedExtrinsic>& proposed() const { return proposed_; }
  [[nodiscard]] const Camera& camera() const { return config_.pairs[0].camera.camera; }

  /// To the next window, of this world.
  void pass_time(const World& world = {});
  [[nodiscard]] Service& service() { return *service_; }
  [[nodiscard]] const std::filesystem::path& folder() const { return folder_.path(); }
  [[nodiscard]] const PairState& state() const { return service_->state(0); }
  [[nodiscard]] PairStatus status() const { return service_->status().pairs.at(0); }
  [[nodiscard]] Verdict verdict() const { return state().verdict; }
  [[nodiscard]] const std::string& reason() const { return state().reason; }
  [[nodiscard]] std::uint64_t skipped(const std::string& code) const;
  /// Angle, degrees, between the extrinsic in force and where a LiDAR is that has moved by `motion`.
  [[nodiscard]] double error_deg(const Vector6& motion) const;
  [[nodiscard]] const Moment& now() const { return now_; }

 private:
  class StereoCamera;
  class Sensors;
  class Window;
  void open();
  void sample(const World& world);
  [[nodiscard]] static FramePair samples(Timestamp stamp, const World& world);

  TemporaryFolder folder_;
  Config config_;
  Result<Config> config_file_ = Config{};
  World world_;  // at present
  std::unique_ptr<Service> service_;
  std::unique_ptr<sqlite3, int (*)(sqlite3*)> other_program_;
  Moment start_{std::chrono::seconds(1'800'000'000), std::chrono::seconds(100)}, now_ = start_;
  Timestamp stamp_{};  // of the image that was sent last
  int windows_ = 0;    // so far
  std::uint64_t first_record_ = 1;
  std::vector<Verdict> alerts_;
  std::vector<std::string> journal_;
  std::vector<ProposedExtrinsic> proposed_;
};

}  // namespace calib::test
