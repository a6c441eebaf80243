#include "support/pair_scenario.hpp"

#include <sqlite3.h>

#include <algorithm>
#include "calib/depth_stereo.hpp"
#include "dataset/recording.hpp"
#include "support/quiet_network.hpp"

namespace calib::test {
namespace {

using namespace std::chrono_literals;

constexpr std::chrono::seconds period = 10s;
constexpr int school_windows = 300;
const Provenance provenance{"car", std::string(64, 'c'), "1.2.3", std::string(64, 'd'), "boot"};

/// How a LiDAR that has moved sees the same places.
void move(LidarScan& scan, const Vector6& motion) {
  const Eigen::Isometry3f T = perturbation(motion).inverse().cast<float>();
  for (LidarPoint& point : scan.points) {
    const Eigen::Vector3f p = T * Eigen::Vector3f(point.x_m, point.y_m, point.z_m);
    point = {p.x(), p.y(), p.z(), point.reflectance};
  }
}

double hours(int windows) { return std::chrono::duration<double, std::ratio<3600>>(windows * period).count(); }

std::size_t frame_at(Timestamp stamp) { return static_cast<std::size_t>(stamp / period) % Block::frames; }

/// A folder with the store and the key of a pair that has learned its baseline; made once.
const std::filesystem::path& school() {
  static const TemporaryFolder folder;
  static const bool made = [] {
    PairScenario scenario({.learned = false});
    scenario.drive(school_windows);
    if (scenario.verdict() != Verdict::calibrated)
      throw std::runtime_error("nothing was learned: " + scenario.reason());
    scenario.save(folder.path());
    return true;
  }();
  static_cast<void>(made);
  return folder.path();
}

}  // namespace

const Block& Block::instance() {
  static const Block block = [] {
    if (!recording.empty()) {
      Block made{require_ok(vehicle::recorded_vehicle(require_ok(open_kitti_raw(recording)))), {}, {}};
      made.see();
      return made;
    }
    vehicle::Simulation simulation;
    simulation.seed = 71;
    simulation.width = 480;
    simulation.height = 144;
    simulation.lidar = {.azimuth_step_deg = 0.3, .field_of_view_deg = 110};
    Block made{require_ok(vehicle::simulated_vehicle(simulation)), {}, {}};
    made.see();
    return made;
  }();
  return block;
}

void Block::see() {
  const auto stereo = require_ok(make_stereo_depth(vehicle.camera, vehicle.baseline_m));
  for (int i = 0; i < frames; ++i) {
    seen.push_back(require_ok(vehicle.frame(i, 4.0 * i, RigidTransform::Identity())));
    depth.push_back(require_ok(stereo->estimate(seen.back())));
  }
}

Vector6 moved(double roll_deg, double pitch_deg, double yaw_deg, double x_cm, double y_cm, double z_cm) {
  Vector6 motion;
  motion << roll_deg * radians_per_degree, pitch_deg * radians_per_degree, yaw_deg * radians_per_degree, x_cm / 100,
      y_cm / 100, z_cm / 100;
  return motion;
}

/// Stereo depth: the block's where the images are, else computed.
class PairScenario::StereoCamera final : public DepthEstimator {
 public:
  explicit StereoCamera(const World& world)
      : world_(world),
        stereo_(require_ok(make_stereo_depth(Block::instance().vehicle.camera, Block::instance().vehicle.baseline_m))) {
  }

  Result<DepthMap> estimate(const FramePair& pair) override {
    auto depth = world_.samples ? stereo_->estimate(pair) : Block::instance().depth[frame_at(pair.image.stamp)];
    if (depth && world_.depth) world_.depth(*depth);
    return depth;
  }

 private:
  const World& world_;
  std::unique_ptr<DepthEstimator> stereo_;
};

/// What the vehicle sends while a window is open: one image of each camera and one scan, at once.
class PairScenario::Window final : public SampleSource {
 public:
  explicit Window(PairScenario& scenario) : scenario_(scenario) {}

  Result<std::vector<Sample>> wait(std::chrono::nanoseconds timeout) override {
    std::vector<Sample> sent;
    if (!std::exchange(sent_, true)) {
      if (!scenario_.world_.repeating) scenario_.stamp_ = scenario_.windows_ * period;
      FramePair pair = samples(scenario_.stamp_, scenario_.world_);
      if (scenario_.world_.camera) {
        sent.emplace_back(RightImage{std::move(*pair.right_image)});
        sent.emplace_back(LeftImage{std::move(pair.image)});
      }
      if (scenario_.world_.lidar) {
        DecodedCloud cloud;
        static_cast<LidarScan&>(cloud) = std::move(pair.scan);
        sent.emplace_back(std::move(cloud));
      }
      if (scenario_.world_.sent) scenario_.world_.sent(sent);
    } else {
      scenario_.now_.wall += timeout;
      scenario_.now_.since_boot += timeout;
    }
    return sent;
  }

 private:
  PairScenario& scenario_;
  bool sent_ = false;
};

class PairScenario::Sensors final : public QuietNetwork {
 public:
  explicit Sensors(PairScenario& scenario) : scenario_(scenario) {}

  Result<std::unique_ptr<SampleSource>> open_window(const PairTopics&) override {
    return std::make_unique<Window>(scenario_);
  }
  Result<void> publish_proposed(std::span<const ProposedExtrinsic> proposed, WallTime) override {
    scenario_.proposed_.assign(proposed.begin(), proposed.end());
    return {};
  }
  Result<void> publish_alert(const DriftAlert& alert) override {
    scenario_.alerts_.push_back(alert.verdict);
    return {};
  }

 private:
  PairScenario& scenario_;
};

PairScenario::PairScenario(const Settings& settings) : other_program_(nullptr, &sqlite3_close) {
  const vehicle::Vehicle& vehicle = Block::instance().vehicle;
  config_.vehicle = "car";
  config_.sha256 = provenance.configuration_sha256;
  const StereoDepthConfig stereo{.right_image = "/right",
                                 .right_camera = rectified_right_camera(vehicle.camera, vehicle.baseline_m),
                                 .right_info = {}};
  config_.state_dir = config_.head_dir = config_.runtime_dir = folder_.path();
  config_.pairs.push_back(
      {.name = "front",
       .camera = {.image = "/image",
                  .info = settings.camera_info ? std::optional(CameraInfoTopic{"/info"}) : std::nullopt,
                  .frame_id = settings.camera_frame,
                  .camera = vehicle.camera},
       .lidar = {.cloud = "/cloud"},
       .T_camera_lidar = vehicle.T_camera_lidar * perturbation(settings.wrong_from_start),
       .depth = stereo,
       .depth_range = {0.5, 200},
       .drift = {},
       .recalibration = {.mode = settings.mode, .frames = 16},
       .evidence_text = std::string(64, 'e')});
  if (settings.learned) {
    for (const auto& file : std::filesystem::directory_iterator(school()))
      std::filesystem::copy(file.path(), folder_.path());
    windows_ = school_windows;
    start_.since_boot -= school_windows * period;  // the machine was started again since
  } else {
    require_ok(SigningKey::generate().save(folder_.path() / "signing.key"));
  }
  open();
  if (!settings.learned) return;
  drive(least_pairs_to_confirm);  // this run has to see for itself
  alerts_.clear();
  journal_.clear();
  first_record_ = service_->ledger().next_sequence();
}

PairScenario::~PairScenario() = default;

void PairScenario::open() {
  now_ = {start_.wall + windows_ * period, start_.since_boot + windows_ * period};
  auto ledger = require_ok(Ledger::open(folder_.path(), folder_.path(),
                                        require_ok(SigningKey::load(folder_.path() / "signing.key")), provenance));
  const std::size_t before = alerts_.size();
  service_ = require_ok(
      Service::make(config_, std::move(ledger), std::make_unique<Sensors>(*this),
                    {.clock = [this] { return now_; },
                     .log = [this](int, std::string_view, const JournalText& what) { journal_.push_back(what.text); },
                     .make_depth = [this](const PairConfig&) -> Result<std::unique_ptr<DepthEstimator>> {
                       return std::make_unique<StereoCamera>(world_);
                     },
                     .read_config = [this] { return config_file_; }}));
  // Those that were sent before are sent again.
  const auto sent = std::min(before, alerts_.size() - before);
  alerts_.erase(alerts_.begin() + static_cast<std::ptrdiff_t>(before),
                alerts_.begin() + static_cast<std::ptrdiff_t>(before + sent));
}

void PairScenario::save(const std::filesystem::path& folder) {
  service_->save_evidence();
  service_.reset();
  for (const auto& file : std::filesystem::directory_iterator(folder_.path()))
    std::filesystem::copy(file.path(), folder);
  open();
}

void PairScenario::restart(const std::string& sql, const std::string& evidence_text) {
  if (!evidence_text.empty()) config_.pairs[0].evidence_text = evidence_text;
  service_->save_evidence();  // as `run` does at its end
  service_.reset();
  if (!sql.empty()) {
    sqlite3* database = nullptr;
    sqlite3_open((folder_.path() / "calibd.db").c_str(), &database);
    const int done = sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr);
    sqlite3_close(database);
    if (done != SQLITE_OK) throw std::runtime_error("SQLite refuses: " + sql);
  }
  open();
}

void PairScenario::crash() {
  service_.reset();
  open();
}

void PairScenario::lock_store(bool locked) {
  other_program_.reset();
  if (!locked) return;
  sqlite3* database = nullptr;
  sqlite3_open((folder_.path() / "calibd.db").c_str(), &database);
  other_program_.reset(database);
  if (sqlite3_exec(database, "BEGIN IMMEDIATE", nullptr, nullptr, nullptr) != SQLITE_OK)
    throw std::runtime_error("SQLite does not lock the store");
}

void PairScenario::drive(int windows, const Course& course) {
  for (int i = 0; i < windows; ++i) sample(course(hours(i)));
}

int PairScenario::drive_until(Verdict wanted, int most, const Course& course) {
  int windows = 0;
  while (verdict() != wanted && windows <= most) sample(course(hours(windows++)));
  return windows;
}

void PairScenario::pass_time(const World& world) {
  world_ = world;
  ++windows_;
  now_ = {start_.wall + windows_ * period, start_.since_boot + windows_ * period};
}

Measurement PairScenario::measure(int frame, const World& world) {
  world_ = world;
  PairState state;
  state.T_camera_lidar = config_.pairs[0].T_camera_lidar;
  StereoCamera depth(world_);
  return require_ok(service_->pipeline(0).measure(samples(frame * period, world), state, depth));
}

void PairScenario::observe(Measurement measurement) {
  pass_time();
  measurement.features.stamp = windows_ * period;
  measurement.received = now_.since_boot;
  service_->conclude(0, std::move(measurement));
}

void PairScenario::sample(const World& world) {
  pass_time(world);
  service_->sample(0);
}

FramePair PairScenario::samples(Timestamp stamp, const World& world) {
  FramePair pair = Block::instance().seen[frame_at(stamp)];
  if (world.frozen) {
    pair.image = Block::instance().seen[0].image;
    pair.right_image = Block::instance().seen[0].right_image;
  }
  move(pair.scan, world.motion);
  if (world.samples) world.samples(pair);
  pair.image.stamp = pair.right_image->stamp = pair.scan.stamp = stamp;
  pair.scan.stamp += world.lidar_clock;
  return pair;
}

int PairScenario::alerts(Verdict verdict) const { return static_cast<int>(std::ranges::count(alerts_, verdict)); }

int PairScenario::records(Decision decision) const {
  int count = 0;
  const Ledger& ledger = service_->ledger();
  for (std::uint64_t i = first_record_; i < ledger.next_sequence(); ++i)
    count += require_ok(ledger.find("front", i)).decision == decision;
  return count;
}

CalibrationRecord PairScenario::last_record() const {
  return require_ok(service_->ledger().find("front", service_->ledger().next_sequence() - 1));
}

std::string PairScenario::reason(Decision decision) const {
  std::string last;
  const Ledger& ledger = service_->ledger();
  for (std::uint64_t i = first_record_; i < ledger.next_sequence(); ++i)
    if (const auto record = require_ok(ledger.find("front", i)); record.decision == decision) last = record.reason;
  return last;
}

std::uint64_t PairScenario::skipped(const std::string& code) const {
  const auto found = state().skipped.find(code);
  return found == state().skipped.end() ? 0 : found->second;
}

double PairScenario::error_deg(const Vector6& motion) const {
  const RigidTransform truth = Block::instance().vehicle.T_camera_lidar * perturbation(motion);
  return rotation_angle_rad(truth.inverse() * state().T_camera_lidar) / radians_per_degree;
}

}  // namespace calib::test
