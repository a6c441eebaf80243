#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "calib/pairing.hpp"
#include "config.hpp"
#include "control.hpp"
#include "dds/bus.hpp"
#include "depth_source.hpp"
#include "doctor.hpp"
#include "ledger.hpp"
#include "pair_monitor.hpp"

namespace calib {

/// The recipe: sample each pair, ask whether its extrinsic still is the best of its neighbours, and recalibrate when it
/// is not. One thread runs it and owns everything of the estimator; other threads ask questions and read the last
/// status.
class Service {
 public:
  /// Takes over what the ledger remembers. Writes an `initial` record for each pair whose configured extrinsic is new.
  [[nodiscard]] static Result<std::unique_ptr<Service>> make(Config config, Ledger ledger, Bus bus);

  /// Samples until `stop` is called. `alive` is called whenever a step of the pipeline was done, at least once a second
  /// while there is nothing to do: it feeds the watchdog.
  void run(const std::function<void()>& alive);
  void stop();

  /// From any thread; answered between two steps of the pipeline.
  void ask(Question question);
  /// From any thread: whether depth is being estimated, which may not end at once when asked.
  [[nodiscard]] bool estimates_depth() const;
  /// From any thread: the status as of the last change, with the ages as of now.
  [[nodiscard]] Status status() const;

 private:
  struct Watch {
    const PairConfig* config;
    PairTopics topics;
    DepthSource* depth;  // the monitor's
    PairMonitor monitor;
    PairState state;
    int windows_without_evidence = 0;
    std::string last_skip{};
    std::uint64_t retry_at = 0;  // value of `state.evaluated` from which the next recalibration may run
    struct Arrival {
      std::optional<std::chrono::steady_clock::time_point> last{};
    };
    Arrival image{}, right_image{}, depth_image{}, cloud{};
    std::optional<std::chrono::nanoseconds> time_difference{};
  };

  Service(Config config, Ledger ledger, Bus bus)
      : config_(std::move(config)), ledger_(std::move(ledger)), bus_(std::move(bus)) {}

  // service.cpp: sampling
  void sample(Watch& watch);
  [[nodiscard]] bool prepare(Watch& watch);
  [[nodiscard]] Result<FramePair> collect(Watch& watch);
  [[nodiscard]] std::optional<Error> receive(Watch& watch, Sample sample, PairBuffer& buffer);
  void evaluated(Watch& watch, const FramePair& pair, const PairMonitor::Evidence& evidence);
  void skipped(Watch& watch, const Error& error);
  void conclude(Watch& watch);
  void breathe(std::chrono::steady_clock::time_point until);
  [[nodiscard]] bool stopping() const;

  // service_decisions.cpp: what is written down
  [[nodiscard]] Result<void> take_over(const PairConfig& pair);
  [[nodiscard]] DriftAlert alert(const Watch& watch, const PairState& after) const;
  bool write(Watch& watch, PairState after, std::optional<CalibrationRecord> record);
  [[nodiscard]] nlohmann::json recalibrate(Watch& watch, const std::string& asked_by, bool dry_run);
  [[nodiscard]] nlohmann::json put_in_force(Watch& watch, CalibrationRecord record);
  /// Nothing: it is for the doctor.
  [[nodiscard]] std::optional<nlohmann::json> answer(const Question& question);
  [[nodiscard]] nlohmann::json accept(Watch& watch, const std::string& asked_by);
  [[nodiscard]] nlohmann::json roll_back(Watch& watch, const nlohmann::json& to, const std::string& asked_by);

  // service_doctor.cpp: what is wrong
  void see_doctor();
  void examine(Watch& watch, nlohmann::json& reply);
  [[nodiscard]] Result<std::optional<FramePair>> listen(Watch& watch, PairSeen& seen);
  [[nodiscard]] std::optional<DepthMap> try_depth(Watch& watch, const FramePair& pair, PairSeen& seen);

  // service_status.cpp: what is shown
  [[nodiscard]] PairStatus status_of(const Watch& watch) const;
  void publish_status();
  void publish_diagnostics();
  void publish_extrinsics();

  Config config_;
  Ledger ledger_;
  Bus bus_;
  std::vector<std::unique_ptr<Watch>> watches_;
  std::function<void()> alive_;
  std::chrono::steady_clock::time_point started_ = std::chrono::steady_clock::now();
  std::chrono::steady_clock::time_point next_diagnostics_{};
  std::set<std::string> failures_logged_;
  std::deque<Question> doctor_questions_;

  mutable std::mutex mutex_;  // guards what is below
  std::condition_variable wake_;
  bool stopping_ = false;
  std::deque<Question> questions_;
  Status status_;
  std::chrono::steady_clock::time_point status_collected_{};
};

/// Both clocks of a record, now.
[[nodiscard]] Moment now();

}  // namespace calib
