#pragma once

#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <set>
#include <string>
#include <vector>

#include "calib/pairing.hpp"
#include "config.hpp"
#include "control.hpp"
#include "control_codec.hpp"
#include "depth_source.hpp"
#include "journal.hpp"
#include "ledger.hpp"
#include "network.hpp"
#include "pair_pipeline.hpp"

namespace calib {

/// What a service lives in; a test gives it a clock, a journal and depth of its own.
struct Surroundings {
  Clock clock = system_clock;
  /// May be called from any thread.
  std::function<void(int priority, std::string_view message_id, const JournalText& what)> log = journal;
  /// In the place of the depth that the configuration asks for.
  DepthSource::Make make_depth{};
  /// Called by the thread that runs whenever there is something new to show.
  std::function<void()> status_changed = [] {};
  /// Reads the configuration again, checked as at a start.
  std::function<Result<Config>()> read_config = [] {
    return fail(ErrorCode::failed, "there is no configuration file");
  };
};

/// A request that waits for its turn. `reply` may be called from any thread, once.
struct PendingRequest {
  ControlRequest request;
  Peer peer;
  std::function<void(ControlReply)> reply;
  /// Set when the client has disconnected.
  std::shared_ptr<const std::atomic<bool>> client_gone = std::make_shared<const std::atomic<bool>>(false);
  std::shared_ptr<const SentFile> file{};
};

/// Samples each pair, has the pipeline measure and decide, and makes what it decides happen, in one order: the ledger's
/// transaction, then the bus and the journal, then the reply. What was decided counts only once the transaction has
/// committed. Evidence that decides nothing counts at once and is written once a minute and at the end: a crash or a
/// power cut costs a minute of it at most, and no decision. While something cannot be written nothing is added. One
/// thread runs it and owns pairs, ledger and depth sources; another shows its last status, by its own clock: when the
/// first one hangs, what is shown grows stale by itself.
class Service {
 public:
  /// Restores each pair from the ledger. Writes an `initial` record for each whose configured extrinsic is new.
  [[nodiscard]] static Result<std::unique_ptr<Service>> make(Config config, Ledger ledger,
                                                             std::unique_ptr<Network> network,
                                                             Surroundings surroundings = {});

  /// Samples until `stop` is called. `alive` is called whenever a step of the pipeline was done, at least once a second
  /// while there is nothing to do: it feeds the watchdog.
  /// Fails with `store_moved`: only a new start mends that.
  [[nodiscard]] Result<void> run(const std::function<void()>& alive);
  void stop();

  // The steps of `run`, for one thread. `pair` is a pair's place in the configuration.

  /// One window of sampling, and what is decided from it.
  void sample(std::size_t pair);
  /// Decides as at the end of a window.
  void conclude(std::size_t pair, Measurement measurement);
  void conclude(std::size_t pair, const Skip& skip);
  [[nodiscard]] Result<Answer> recalibrate(std::size_t pair, std::string asked_by, bool dry_run, Comment comment = {});
  [[nodiscard]] Result<Answer> accept(std::size_t pair, std::string asked_by, Comment comment = {});
  /// Back to the extrinsic of record `to`; of the one before the present one when there is none.
  [[nodiscard]] Result<Answer> roll_back(std::size_t pair, std::optional<std::uint64_t> to, std::string asked_by,
                                         Comment comment = {});
  /// As `Ledger::change_key`; evidence that rests on doubted records is set aside.
  [[nodiscard]] Result<Answer> change_key(Ledger::NewKey request);
  /// Takes over of a changed configuration what can change without losing state. One that is wrong changes nothing.
  [[nodiscard]] Result<ConfigChanges> reload();
  /// Writes the evidence that waits, of all pairs at once. `run` does that once a minute and at its end.
  void save_evidence();
  /// For how long it waits at most.
  static constexpr std::chrono::nanoseconds longest_unsaved = std::chrono::minutes(1);
  /// The state that counts; evidence in it may wait to be written.
  [[nodiscard]] const PairState& state(std::size_t pair) const { return pairs_[pair]->state; }
  [[nodiscard]] const PairPipeline& pipeline(std::size_t pair) const { return pairs_[pair]->pipeline; }
  [[nodiscard]] const Ledger& ledger() const { return ledger_; }

  // From any thread.

  /// Status and records are shown at once. Everything else waits until the pair that is being sampled is done with:
  /// nothing changes under a measurement. Refused when `most_requests` wait already.
  void ask(PendingRequest request);
  static constexpr std::size_t most_requests = 16;
  /// So many wait for an event, and each so long; then the reply has none.
  static constexpr std::size_t most_waiting_for_events = 4;
  static constexpr std::chrono::seconds longest_wait_for_events{30};
  /// So many windows stay open for the first CameraInfo. A driver that sends none does not cost them for ever.
  static constexpr int windows_for_camera_info = 3;
  /// The status as of the last change, with ages and verdicts as of now.
  [[nodiscard]] Status status() const;
  /// The records from number `from` on, as many as fit into a reply.
  [[nodiscard]] Result<RecordsPage> records(std::uint64_t from) const;
  /// The events above number `after` that wait in the outbox.
  [[nodiscard]] Result<FeedPage> events(std::uint64_t after, std::size_t limit) const;
  /// From the thread that shows things, whenever the status has changed and once a second: writes the snapshot when
  /// what it shows has changed, sends the diagnostics once a second, and returns the verdicts in a line when they are
  /// others.
  [[nodiscard]] std::optional<std::string> show();

 private:
  struct Pair {
    const PairConfig* config;
    PairTopics topics;
    PairPipeline pipeline;
    std::unique_ptr<DepthSource> depth;
    PairState state = {};
    std::optional<Error> store_failure = {};  // of the last attempt to write
    bool has_evidence_since = false;          // later than the state in the store
    /// Time since boot of the first evidence that was not written yet.
    std::optional<std::chrono::nanoseconds> unsaved_since = {};
    std::optional<std::string> depth_failure = {};  // that was logged last
    /// Time since boot at which the last sample of each topic arrived.
    std::optional<std::chrono::nanoseconds> image = {}, right_image = {}, depth_image = {}, cloud = {}, motion = {};
    std::optional<std::chrono::nanoseconds> time_difference = {};
    /// What the last CameraInfo of `camera.info` said. While it contradicts the configuration nothing is evaluated.
    struct HeardCameraInfo {
      bool heard = false;
      int windows_to_wait = 0;  // for the first one
      std::optional<Error> contradiction = {};
      [[nodiscard]] bool keeps_pairs_back() const { return contradiction || (!heard && windows_to_wait > 0); }
    } camera_info = {};
    /// Since the start, by the word of their code.
    std::map<std::string, PairStatus::Remark> remarks = {};
    /// The frames that the last messages named, escaped; empty before.
    std::string camera_frame = {}, lidar_frame = {};
  };

  Service(Config config, Ledger ledger, std::unique_ptr<Network> network, Surroundings surroundings);

  // service.cpp
  [[nodiscard]] Result<void> restore(const PairConfig& config);
  [[nodiscard]] bool commit(Pair& pair, PairDecision& decision);
  [[nodiscard]] bool take_evidence(Pair& pair, PairDecision& decision);
  void save_evidence_when_due();
  void cannot_write(Pair& pair, Error error);
  void publish(const Pair& pair, const PairDecision& decision);
  void apply(Pair& pair, PairDecision decision);
  [[nodiscard]] Result<Answer> apply_request(Pair& pair, PairDecision decision);
  [[nodiscard]] Now now(const Pair& pair) const;
  void answer_requests();
  [[nodiscard]] ControlReply answer(const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const StatusRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const RecordsRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const DiagnosisRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const ReloadRequest& request, const PendingRequest& pending);
  [[nodiscard]] Result<std::size_t> find(const std::string& name) const;

  // service_requests.cpp
  [[nodiscard]] ControlReply answer(const RecalibrationRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const AcceptRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const RollbackRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const KeyRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply change(const std::string& name, const Peer& peer, bool dry_run,
                                    const std::function<Result<Answer>(std::size_t pair, std::string asked_by)>& make);

  // service_diagnosis.cpp
  [[nodiscard]] DiagnosisReport diagnose_pairs(const std::optional<std::string>& name);
  [[nodiscard]] std::optional<Finding> fault_of_network(const Pair& pair, std::chrono::nanoseconds since) const;

  // service_feed.cpp
  void tell_fleet(const Status& status);
  [[nodiscard]] std::string run_id() const;
  [[nodiscard]] ControlReply answer(const FeedRequest& request, const PendingRequest& pending);
  [[nodiscard]] ControlReply answer(const AcknowledgeRequest& request, const PendingRequest& pending);
  [[nodiscard]] bool waits_for_event(PendingRequest& request);
  void answer_who_waits_for_events();
  void answer_acknowledgements();

  // service_sampling.cpp
  [[nodiscard]] std::variant<Measurement, Skip> measure(Pair& pair);
  [[nodiscard]] Error explained(const Pair& pair, Error error, std::chrono::nanoseconds window_began) const;
  [[nodiscard]] std::optional<Skip> prepare(Pair& pair);
  [[nodiscard]] Result<FramePair> collect(Pair& pair);
  void note(Pair& pair, const Error& remark);
  void note(Pair& pair, const std::string& topic, const MessageNotes& notes);
  void note_frame(Pair& pair, const std::string& topic, const MessageNotes& notes, const FrameName& configured,
                  std::string& seen);
  [[nodiscard]] std::optional<Error> receive(Pair& pair, Sample sample, PairBuffer& buffer);
  [[nodiscard]] bool keep_going();
  [[nodiscard]] bool stopping() const;

  // service_status.cpp
  [[nodiscard]] PairStatus status_of(const Pair& pair) const;
  [[nodiscard]] std::optional<CalibrationRecord> proposal(const Pair& pair) const;
  void collect_status();
  void publish_diagnostics(const Status& status);
  void publish_extrinsics();

  Config config_;
  Ledger ledger_;
  std::unique_ptr<Network> network_;
  Surroundings surroundings_;
  std::vector<std::unique_ptr<Pair>> pairs_;
  std::function<void()> alive_ = [] {};
  std::chrono::nanoseconds started_{}, last_alive_{};  // since boot
  bool evidence_file_failed_ = false;                  // the last time; evidence went into the store

  std::map<std::string, std::chrono::nanoseconds> without_verdict_since_;  // by pair, since boot
  std::string store_trouble_;                                              // of which the fleet is told once it is over

  // Of the thread that shows things.
  std::uint64_t collection_told_ = 0;
  std::chrono::nanoseconds next_diagnostics_{};
  std::set<ErrorCode> failures_logged_;
  std::string verdicts_shown_;
  std::uint64_t collection_shown_ = 0;

  mutable std::mutex mutex_;  // guards what is below
  std::condition_variable wake_;
  bool stopping_ = false;
  std::deque<PendingRequest> requests_;
  struct WaitsForEvent {
    PendingRequest request;
    std::chrono::nanoseconds since;  // boot
  };
  std::vector<WaitsForEvent> waiting_for_events_;
  Status status_;
  std::string reload_refused_;  // why, in words; empty when the last reload was not
  std::chrono::nanoseconds status_collected_{};
  std::uint64_t collections_ = 0;
};

/// Digest of what a pair's evidence is measured with: `PairConfig::evidence_text`, the depth network's descriptor,
/// which pins the network, and the software.
[[nodiscard]] std::string evidence_sha256(const PairConfig& pair, const Provenance& provenance);

}  // namespace calib
