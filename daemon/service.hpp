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
#include "pair_watch.hpp"

namespace calib {

/// Samples each pair, has its watch judge what came, tells the world what it decided, and answers questions. One thread
/// runs it and owns everything of the estimator; another shows its last status, by its own clock: when the first one
/// hangs, what is shown grows stale by itself.
class Service {
 public:
  /// Takes over what the ledger remembers. Writes an `initial` record for each pair whose configured extrinsic is new.
  [[nodiscard]] static Result<std::unique_ptr<Service>> make(Config config, Ledger ledger, Bus bus);

  /// Samples until `stop` is called. `alive` is called whenever a step of the pipeline was done, at least once a second
  /// while there is nothing to do: it feeds the watchdog.
  /// Fails with `store_moved`: only a new start mends that.
  [[nodiscard]] Result<void> run(const std::function<void()>& alive);
  void stop();

  /// From any thread; answered between two steps of the pipeline. Refused when `most_questions` wait already.
  void ask(Question question);
  static constexpr std::size_t most_questions = 16;
  /// From any thread: the status as of the last change, with ages and verdicts as of now.
  [[nodiscard]] Status status() const;
  /// From any thread: the records from number `from` on, as many as fit into an answer, as proto/control.md has it.
  [[nodiscard]] nlohmann::json records(const nlohmann::json& from) const;
  /// From the thread that shows things, some times a second: writes the snapshot when what it shows has changed, sends
  /// the diagnostics once a second, and returns the verdicts in a line when they are others.
  [[nodiscard]] std::optional<std::string> show();

 private:
  struct Watch {
    const PairConfig* config;
    PairTopics topics;
    std::unique_ptr<PairWatch> pair;
    DepthSource* depth;  // the pair's
    struct Arrival {
      std::optional<std::chrono::steady_clock::time_point> last{};
    };
    Arrival image{}, right_image{}, depth_image{}, cloud{}, motion{};
    std::optional<std::chrono::nanoseconds> time_difference{};
  };

  Service(Config config, Ledger ledger, Bus bus)
      : config_(std::move(config)), ledger_(std::move(ledger)), bus_(std::move(bus)) {}

  // service.cpp: sampling
  void sample(Watch& watch);
  [[nodiscard]] Result<void> evaluate(Watch& watch);
  [[nodiscard]] bool prepare(Watch& watch);
  [[nodiscard]] Result<FramePair> collect(Watch& watch);
  [[nodiscard]] std::optional<Error> receive(Watch& watch, Sample sample, PairBuffer& buffer);
  void breathe(std::chrono::steady_clock::time_point until);
  [[nodiscard]] bool keep_going();
  [[nodiscard]] bool stopping() const;

  [[nodiscard]] Result<void> take_over(const PairConfig& pair);
  /// Nothing: it is for the doctor.
  [[nodiscard]] std::optional<nlohmann::json> answer(const Question& question);

  // service_doctor.cpp: what is wrong
  void see_doctor();
  void examine(Watch& watch, nlohmann::json& reply);
  [[nodiscard]] Result<std::optional<FramePair>> listen(Watch& watch, PairSeen& seen);
  [[nodiscard]] std::optional<DepthMap> try_depth(Watch& watch, const FramePair& pair, PairSeen& seen);

  // service_status.cpp: what is shown
  [[nodiscard]] PairStatus status_of(const Watch& watch) const;
  void collect_status();
  void publish_diagnostics(const Status& status);
  void publish_extrinsics();

  Config config_;
  Ledger ledger_;
  Bus bus_;
  std::vector<std::unique_ptr<Watch>> watches_;
  std::function<void()> alive_;
  std::chrono::steady_clock::time_point started_ = std::chrono::steady_clock::now();
  std::chrono::steady_clock::time_point last_alive_{};
  std::deque<Question> doctor_questions_;

  // Of the thread that shows things.
  std::chrono::steady_clock::time_point next_diagnostics_{};
  std::set<ErrorCode> failures_logged_;
  std::string verdicts_shown_;
  std::uint64_t collection_shown_ = 0;

  mutable std::mutex mutex_;  // guards what is below
  std::condition_variable wake_;
  bool stopping_ = false;
  std::deque<Question> questions_;
  Status status_;
  std::chrono::steady_clock::time_point status_collected_{};
  std::uint64_t collections_ = 0;
};

/// Digest of what a pair's evidence is measured with: `PairConfig::evidence_text`, the depth network's descriptor,
/// which pins the network, and the software.
[[nodiscard]] std::string evidence_sha256(const PairConfig& pair, const Provenance& provenance);

/// Both clocks of a record, now.
[[nodiscard]] Moment now();

}  // namespace calib
