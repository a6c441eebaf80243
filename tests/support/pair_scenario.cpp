#include "support/pair_scenario.hpp"

#include <sqlite3.h>

#include <algorithm>
#include "calib/depth_stereo.hpp"

namespace calib::test {
namespace {

using namespace std::chrono_literals;

constexpr std::chrono::seconds period = 10s;
constexpr int school_windows = 160;
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
    vehicle::Simulation simulation;
    simulation.seed = 71;
    simulation.width = 480;
    simulation.height = 144;
    simulation.lidar = {.azimuth_step_deg = 0.3, .field_of_view_deg = 110};
    Block made{require_ok(vehicle::simulated_vehicle(simulation)), {}, {}};
    const auto stereo = require_ok(make_stereo_depth(made.vehicle.camera, made.vehicle.baseline_m));
    for (int i = 0; i < frames; ++i) {
      made.seen.push_back(require_ok(made.vehicle.frame(i, 4.0 * i, RigidTransform::Identity())));
      made.depth.push_back(require_ok(stereo->estimate(made.seen.back())));
    }
    return made;
  }();
  return block;
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

PairScenario::PairScenario(const Settings& settings) {
  const vehicle::Vehicle& vehicle = Block::instance().vehicle;
  config_.vehicle = "car";
  config_.sha256 = provenance.configuration_sha256;
  const StereoDepthConfig stereo{.right_image = "/right",
                                 .right_camera = rectified_right_camera(vehicle.camera, vehicle.baseline_m),
                                 .right_info = {}};
  config_.pairs.push_back({.name = "front",
                           .camera = {.image = "/image", .info = {}, .camera = vehicle.camera},
                           .lidar = {.cloud = "/cloud"},
                           .T_camera_lidar = vehicle.T_camera_lidar * perturbation(settings.wrong_from_start),
                           .depth = stereo,
                           .depth_range = {0.5, 200},
                           .drift = {},
                           .recalibration = {.mode = settings.mode, .frames = 16}});
  if (settings.learned) {
    for (const auto& file : std::filesystem::directory_iterator(school()))
      std::filesystem::copy(file.path(), folder_.path());
    windows_ = school_windows;
    now_.wall += school_windows * period;
  } else {
    require_ok(SigningKey::generate().save(folder_.path() / "signing.key"));
  }
  open();
  if (!settings.learned) return;
  drive(least_pairs_to_confirm);  // this run has to see for itself
  alerts_.clear();
  journal_.clear();
  first_record_ = ledger_->next_sequence();
}

PairScenario::~PairScenario() = default;

void PairScenario::open() {
  ledger_.emplace(require_ok(Ledger::open(folder_.path(), folder_.path(),
                                          require_ok(SigningKey::load(folder_.path() / "signing.key")), provenance)));
  const PairListener listener{
      .alert = [this](const DriftAlert& alert) { alerts_.push_back(alert.verdict); },
      .journal = [this](int, std::string_view, const std::string& text) { journal_.push_back(text); },
      .extrinsic_changed = [] {}};
  watch_ = require_ok(PairWatch::take_over(
      config_, config_.pairs[0], evidence_sha256_, std::make_unique<StereoCamera>(world_), *ledger_,
      [this] { return now_; }, listener));
}

void PairScenario::save(const std::filesystem::path& folder) {
  watch_.reset();
  ledger_.reset();
  for (const auto& file : std::filesystem::directory_iterator(folder_.path()))
    std::filesystem::copy(file.path(), folder);
  open();
}

void PairScenario::restart(const std::string& sql, const std::string& evidence_sha256) {
  if (!evidence_sha256.empty()) evidence_sha256_ = evidence_sha256;
  watch_.reset();
  ledger_.reset();
  if (!sql.empty()) {
    sqlite3* database = nullptr;
    sqlite3_open((folder_.path() / "calibd.db").c_str(), &database);
    const int done = sqlite3_exec(database, sql.c_str(), nullptr, nullptr, nullptr);
    sqlite3_close(database);
    if (done != SQLITE_OK) throw std::runtime_error("SQLite refuses: " + sql);
  }
  open();
}

void PairScenario::drive(int windows, const Course& course) {
  for (int i = 0; i < windows; ++i) sample(course(hours(i)));
}

int PairScenario::drive_until(Verdict wanted, int most, const Course& course) {
  int windows = 0;
  while (verdict() != wanted && windows <= most) sample(course(hours(windows++)));
  return windows;
}

void PairScenario::pass_time() {
  ++windows_;
  now_.wall += period;
  now_.since_boot += period;
}

PairMonitor::Evidence PairScenario::measure(int frame, const World& world) {
  world_ = world;
  const PairConfig& pair = config_.pairs[0];
  PairMonitor monitor({}, pair.camera.camera, std::make_unique<StereoCamera>(world_), pair.T_camera_lidar, {});
  return require_ok(monitor.measure(samples(frame * period, world)));
}

void PairScenario::observe(PairMonitor::Evidence evidence) {
  pass_time();
  evidence.features.stamp = windows_ * period;
  watch_->observe(std::move(evidence), now_);
  watch_->conclude();
}

void PairScenario::sample(const World& world) {
  world_ = world;
  pass_time();
  PairBuffer buffer(config_.sampling.max_time_difference, {.right_image = true});
  FramePair sent = samples(windows_ * period, world);
  if (world.camera) {
    buffer.add_right_image(std::move(*sent.right_image));
    buffer.add_image(std::move(sent.image));
  }
  if (world.lidar) buffer.add_scan(std::move(sent.scan));
  const auto pair = buffer.take();
  if (!pair)
    watch_->skip(buffer.why_none());
  else if (const auto evaluated = watch_->evaluate(*pair); !evaluated)
    watch_->skip(evaluated.error());
  watch_->conclude();
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
  for (std::uint64_t i = first_record_; i < ledger_->next_sequence(); ++i)
    count += require_ok(ledger_->find("front", i)).decision == decision;
  return count;
}

CalibrationRecord PairScenario::last_record() const {
  return require_ok(ledger_->find("front", ledger_->next_sequence() - 1));
}

std::string PairScenario::reason(Decision decision) const {
  std::string last;
  for (std::uint64_t i = first_record_; i < ledger_->next_sequence(); ++i)
    if (const auto record = require_ok(ledger_->find("front", i)); record.decision == decision) last = record.reason;
  return last;
}

std::uint64_t PairScenario::skipped(const std::string& code) const {
  const auto found = watch_->state().skipped.find(code);
  return found == watch_->state().skipped.end() ? 0 : found->second;
}

double PairScenario::error_deg(const Vector6& motion) const {
  const RigidTransform truth = Block::instance().vehicle.T_camera_lidar * perturbation(motion);
  return rotation_angle_rad(truth.inverse() * watch_->status().T_camera_lidar) / radians_per_degree;
}

}  // namespace calib::test
