// Faults in random order and combination: whoever reads a status, in whatever way, never sees `calibrated` when there
// is no evidence for it. The service, its ledger, its store and the status' readers are the real ones; sensors are a
// number of degrees, and clocks are turned by hand.
#include <sqlite3.h>
#include <sys/resource.h>

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <map>
#include <nlohmann/json.hpp>

#include "service.hpp"
#include "support/catch.hpp"
#include "support/quiet_network.hpp"
#include "support/support.hpp"
#include "vehicle/random.hpp"

using namespace calib;
using namespace std::chrono_literals;
using test::require_ok;

namespace {

constexpr int baseline_pairs = 5;
constexpr std::chrono::seconds period = 10s, window = 2s;

/// While it lives, nothing can be written to any file.
class FullDisk {
 public:
  FullDisk() { limit(0); }
  ~FullDisk() { limit(RLIM_INFINITY); }

 private:
  static void limit(rlim_t bytes) {
    const rlimit value{bytes, RLIM_INFINITY};
    std::signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &value);
  }
};

/// A parabola whose top is `off` of the LiDAR's place, per axis.
Measurement measurement_at(Timestamp stamp, const Vector6& off, vehicle::Random& random) {
  Measurement evidence;
  evidence.features.stamp = stamp;
  evidence.stencil.current = 1.3 + 0.005 * random.gaussian();
  auto& [step_of, minus, plus] = evidence.stencil.widths.emplace_back();
  evidence.sensitivity = Matrix6::Zero();
  const double height = 0.05 + 0.005 * random.gaussian();
  for (int axis = 0; axis < 6; ++axis) {
    const double step = step_of.of_axis(axis), curvature = 0.1 / (step * step);
    const double top = off[axis] + 0.03 * step * random.gaussian();
    plus[axis] = evidence.stencil.current - height + curvature * step * top;
    minus[axis] = evidence.stencil.current - height - curvature * step * top;
    (*evidence.sensitivity)(axis, axis) = curvature * (1 + 0.05 * random.gaussian());
  }
  return evidence;
}

/// What the world knows, whatever calibd believes.
struct Truth {
  bool running = false;
  bool store_works = true;  // as far as this run can write to the file that the next one will read
  bool last_write_worked = true;
  /// Since when pairs of this run came that cannot be written, on the clock that nobody turns; how long, at the last
  /// one.
  std::optional<std::chrono::nanoseconds> unwritten_since;
  std::chrono::nanoseconds unwritten{};
  std::uint64_t pairs_of_run = 0;
  std::optional<std::chrono::nanoseconds> last_pair;  // of this run, on the clock that nobody turns
  std::map<std::string, std::uint64_t> pairs_with;    // by what they were measured with, ever
  bool wrong_key = false;                             // of this run
  bool baseline_is_signed = false;                    // of the extrinsic in force, by what is measured with now
};

/// One vehicle, from one fault to the next.
class Vehicle {
 public:
  explicit Vehicle(std::uint64_t seed) : random_(seed) {
    for (const char* name : {"signing.key", "another.key"})
      require_ok(SigningKey::generate().save(folder_.path() / name));
    for (const char* name : {"state", "head", "copy"}) std::filesystem::create_directory(folder_.path() / name);
    config_.vehicle = "car";
    config_.state_dir = folder_.path() / "state";
    config_.sampling = {.period = period, .window = window};
    const auto camera = require_ok(Camera::make(CameraModel::rectified, 640, 192, {400, 400, 320, 96}));
    config_.pairs.push_back({.name = "front",
                             .camera = {.image = "/image", .info = {}, .camera = camera},
                             .lidar = {.cloud = "/cloud"},
                             .depth = StereoDepthConfig{.right_image = "/right", .right_camera = {}, .right_info = {}},
                             .depth_range = {},
                             .drift = {.baseline_pairs = baseline_pairs, .min_scene_change = 0},
                             .recalibration = {.mode = RecalibrationMode::propose}});
    start();
  }

  void step() {
    switch (random_.below(18)) {
      case 0:
        return pass(random_.below(2) == 0 ? 1s : std::chrono::seconds(random_.below(200)));  // the worker hangs
      case 1:
        now_.wall += random_.below(2) == 0 ? -24h * 90 : 24h * 90;
        return;
      case 2:
        full_disk_ = !full_disk_;
        return;
      case 3:
        return restart([] {});
      case 4:
        return restart([this] { reboot(); });
      case 5:
        return restart([this] { measured_with_ = measured_with_ == "camera" ? "another camera" : "camera"; });
      case 6:
        return restart([this] { execute("DELETE FROM record WHERE sequence > 1"); });
      case 7:
        return restart([this] { execute("DELETE FROM record"); });
      case 8:
        return restart([this] { execute("UPDATE state SET json = replace(json, '1', '2')"); });
      case 9:
        return restart([this] { put("state", "copy"); });
      case 10:
        return restart([this] { put("copy", "state"); });
      case 11:
        // Another file in its place, under the daemon's hands.
        std::filesystem::rename(store(), store().string() + ".old");
        std::filesystem::copy(store().string() + ".old", store());
        truth_.store_works = false;
        return;
      case 12:
        for (int i = 0; i < 3; ++i) sample(false);
        return;
      case 13:
        return restart([this] { key_ = key_ == "signing" ? "another" : "signing"; });
      case 14:
        return restart([this] { trusts_ = !trusts_; });
      default:
        for (int i = random_.below(8); i >= 0; --i) sample(true);
    }
  }

  /// Everything is well again: after as many pairs as a new vehicle takes, the verdict is there.
  void heal() {
    full_disk_ = false;
    restart([this] { key_ = "signing"; });
    // All records may have been deleted while the other key was there: then these are its.
    if (truth_.running && service_->ledger().signing_refused()) restart([this] { key_ = "another"; });
    for (std::uint64_t i = 0; i < baseline_pairs + least_pairs_to_confirm; ++i) sample(true);
  }

  /// As each way of reading has it, now.
  void look() {
    if (truth_.running) {
      collect();
      check(service_->status().pairs.at(0).verdict, "the daemon", truth_);
    }
    if (snapshot_.empty()) return;
    Status read = require_ok(parse_status(nlohmann::json::parse(snapshot_)));
    expire(read, boot_time());
    check(read.pairs[0].verdict, "the snapshot", snapshot_truth_);
  }

  [[nodiscard]] std::string reason() const { return service_->status().pairs.at(0).reason; }
  std::uint64_t seen_calibrated = 0;
  std::string history;

 private:
  [[nodiscard]] std::filesystem::path store() const { return folder_.path() / "state" / "calibd.db"; }
  [[nodiscard]] BootTime boot_time() const { return {boot_id_, now_.since_boot}; }

  void check(Verdict verdict, const char* who, const Truth& truth) {
    if (verdict != Verdict::calibrated) return;
    ++seen_calibrated;
    INFO(who << " at " << history);
    REQUIRE(truth.pairs_of_run >= least_pairs_to_confirm);
    REQUIRE(truth.last_pair);
    REQUIRE(steady_ - *truth.last_pair <= 2 * period + window);
    REQUIRE(truth.last_write_worked);
    if (truth.wrong_key)
      REQUIRE(truth.baseline_is_signed);  // what is learned meanwhile cannot be
    else
      REQUIRE(truth.unwritten < Service::longest_unsaved);  // a full disk is noticed when evidence is written
    REQUIRE(truth.pairs_with.at(measured_with_at_snapshot(who)) >= baseline_pairs);
  }
  [[nodiscard]] const std::string& measured_with_at_snapshot(std::string_view who) const {
    return who == "the snapshot" ? snapshot_measured_with_ : measured_with_;
  }

  void pass(std::chrono::nanoseconds time) {
    now_.wall += time;
    now_.since_boot += time;
    steady_ += time;
    history += "wait ";
  }
  void reboot() {
    boot_id_ += 'b';
    now_.since_boot = std::chrono::seconds(random_.below(100));
    steady_ += 24h;
    history += "reboot ";
  }
  /// What a status would hold, taken whenever something has changed.
  void collect() {
    truth_.wrong_key = service_->ledger().signing_refused().has_value();
    REQUIRE(service_->status().signing_refused.has_value() == truth_.wrong_key);
    const std::string measured_with = evidence_sha256(config_.pairs[0], service_->ledger().provenance());
    truth_.baseline_is_signed = service_->ledger().history("front").known_baseline(measured_with) != nullptr;
    snapshot_ = to_json(service_->status()).dump();
    snapshot_truth_ = truth_;
    snapshot_measured_with_ = measured_with_;
  }

  void sample(bool sensors) {
    pass(period);
    if (!truth_.running) return;
    history += sensors ? "pair " : "silence ";
    std::optional<FullDisk> full;
    if (full_disk_) full.emplace();
    if (sensors) {
      Measurement measurement = measurement_at(now_.wall, Vector6::Zero(), random_);
      measurement.received = now_.since_boot;
      service_->conclude(0, std::move(measurement));
      ++truth_.pairs_of_run;
      ++truth_.pairs_with[measured_with_];
      truth_.last_pair = steady_;
    } else {
      service_->conclude(0, Skip{{ErrorCode::sensor_silent, "the camera is silent"}});
    }
    truth_.last_write_worked = truth_.store_works;
    if (!full_disk_) truth_.unwritten_since.reset();
    if (full_disk_ && !truth_.unwritten_since) truth_.unwritten_since = steady_;
    truth_.unwritten = truth_.unwritten_since ? steady_ - *truth_.unwritten_since : 0s;
    full.reset();
    look();
  }

  template <typename Meanwhile>
  void restart(Meanwhile meanwhile) {
    service_.reset();
    truth_.running = false;
    history += "stop ";
    meanwhile();
    start();
  }

  void start() {
    history += "start ";
    std::optional<FullDisk> full;
    if (full_disk_) full.emplace();
    truth_.pairs_of_run = 0;
    truth_.last_pair.reset();
    truth_.store_works = truth_.last_write_worked = true;
    truth_.unwritten_since.reset();
    truth_.unwritten = 0s;
    const Provenance provenance{"car", std::string(64, 'c'), "1.2.3", std::string(64, 'd'), boot_id_};
    history += key_ + ' ';
    const auto trusted = require_ok(load_public_key(folder_.path() / "signing.pub"));
    auto ledger = Ledger::open(folder_.path() / "state", folder_.path() / "head",
                               require_ok(SigningKey::load(folder_.path() / (key_ + ".key"))), provenance, {},
                               trusts_ ? std::optional(trusted) : std::nullopt);
    if (!ledger) return;
    config_.pairs[0].evidence_text = measured_with_;
    auto service = Service::make(config_, std::move(*ledger), std::make_unique<test::QuietNetwork>(),
                                 {.clock = [this] { return now_; }, .log = [](int, auto, auto) {}, .make_depth = {}});
    if (!service) return;
    service_ = std::move(*service);
    truth_.running = true;
  }

  void execute(const char* sql) {
    sqlite3* database = nullptr;
    sqlite3_open(store().c_str(), &database);
    sqlite3_exec(database, sql, nullptr, nullptr, nullptr);
    sqlite3_close(database);
    history += sql;
  }
  void put(const char* from, const char* to) {
    std::filesystem::remove_all(folder_.path() / to);
    std::filesystem::copy(folder_.path() / from, folder_.path() / to);
    history += std::string(from) + "->" + to + ' ';
  }

  test::TemporaryFolder folder_;
  vehicle::Random random_;
  Config config_;
  std::string measured_with_ = "camera", snapshot_measured_with_;
  std::string boot_id_ = "boot";
  Moment now_{1'800'000'000s, 100s};
  std::chrono::nanoseconds steady_{};
  bool full_disk_ = false;
  std::string key_ = "signing";
  bool trusts_ = true;  // the public key lies beside it
  std::unique_ptr<Service> service_;
  Truth truth_, snapshot_truth_;
  std::string snapshot_;
};

/// `CALIBD_FAULT_SEQUENCES`, for a longer run by hand.
std::uint64_t sequences() {
  const char* wanted = std::getenv("CALIBD_FAULT_SEQUENCES");
  return wanted != nullptr ? std::strtoull(wanted, nullptr, 10) : 300;
}

}  // namespace

TEST_CASE("whatever fails, in whatever order, calibrated is not shown without evidence") {
  std::uint64_t seen = 0, healed = 0;
  for (std::uint64_t seed = 1; seed <= sequences(); ++seed) {
    Vehicle vehicle(seed);
    for (int i = 0; i < 20; ++i) {
      vehicle.step();
      vehicle.look();
    }
    seen += vehicle.seen_calibrated;
    const std::uint64_t before = vehicle.seen_calibrated;
    vehicle.heal();
    INFO("sequence " << seed << ": " << vehicle.history << ": " << vehicle.reason());
    CHECK(vehicle.seen_calibrated > before);
    healed += vehicle.seen_calibrated > before;
  }
  INFO(seen << " times calibrated in " << sequences() << " sequences");
  CHECK(healed == sequences());
  CHECK(seen > sequences());
}
