#include "service.hpp"

#include <time.h>

#include <algorithm>

#include "journal.hpp"
#include "message_ids.hpp"

namespace calib {
namespace {

using std::chrono::steady_clock;

/// Windows without evidence after which the last verdict no longer counts.
constexpr int windows_to_stale = 2;
constexpr std::chrono::milliseconds slice{200};

std::chrono::nanoseconds read_clock(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return std::chrono::seconds(time.tv_sec) + std::chrono::nanoseconds(time.tv_nsec);
}

/// A CameraInfo contradicts the configuration when it is of another size, or its focal length or centre differ by more
/// than the last digits that people write down.
std::optional<Error> contradiction(const CameraInfo& info, const Camera& camera) {
  if (info.width != camera.width() || info.height != camera.height())
    return Error{"camera_info_mismatch", "CameraInfo is for " + std::to_string(info.width) + " x " +
                                             std::to_string(info.height) + " pixels; correct camera.size"};
  const bool rectified = camera.model() == CameraModel::rectified;
  const std::array<double, 4> theirs = rectified ? std::array{info.P[0], info.P[5], info.P[2], info.P[6]}
                                                 : std::array{info.K[0], info.K[4], info.K[2], info.K[5]};
  const std::array<double, 4> ours{camera.fx(), camera.fy(), camera.cx(), camera.cy()};
  for (std::size_t i = 0; i < ours.size(); ++i)
    if (std::abs(theirs[i] - ours[i]) > 0.5)
      return Error{"camera_info_mismatch", std::string("CameraInfo's ") + (rectified ? "P" : "K") +
                                               " differs from camera.intrinsics; correct the configuration"};
  return std::nullopt;
}

Verdict shown(DriftVerdict verdict) {
  switch (verdict) {
    case DriftVerdict::learning:
      return Verdict::not_evaluated;
    case DriftVerdict::calibrated:
      return Verdict::calibrated;
    case DriftVerdict::suspect:
      return Verdict::suspect;
    case DriftVerdict::drifted:
      return Verdict::drifted;
  }
  return Verdict::not_evaluated;
}

}  // namespace

Moment now() { return {read_clock(CLOCK_REALTIME), read_clock(CLOCK_BOOTTIME)}; }

Result<std::unique_ptr<Service>> Service::make(Config config, Ledger ledger, Bus bus) {
  std::unique_ptr<Service> service(new Service(std::move(config), std::move(ledger), std::move(bus)));
  for (const PairConfig& pair : service->config_.pairs)
    if (auto taken = service->take_over(pair); !taken) return tl::unexpected(taken.error());
  // Alerts that were written but perhaps not sent, and extrinsics that late readers must see.
  const auto waiting = service->ledger_.waiting_alerts(32);
  if (!waiting) return tl::unexpected(waiting.error());
  for (const DriftAlert& alert : *waiting)
    if (auto sent = service->bus_.publish_alert(alert); !sent) return tl::unexpected(sent.error());
  service->publish_extrinsics();
  service->publish_status();
  return service;
}

void Service::run(const std::function<void()>& alive) {
  alive_ = alive;
  auto next = steady_clock::now();
  while (!stopping()) {
    for (auto& watch : watches_) {
      if (!stopping()) sample(*watch);
      see_doctor();
    }
    next = std::max(next + config_.sampling.period, steady_clock::now());
    while (steady_clock::now() < next && !stopping()) {
      breathe(next);
      see_doctor();
    }
  }
}

void Service::stop() {
  const std::lock_guard lock(mutex_);
  stopping_ = true;
  wake_.notify_all();
  bus_.interrupt();
}

bool Service::stopping() const {
  const std::lock_guard lock(mutex_);
  return stopping_;
}

bool Service::estimates_depth() const {
  return std::ranges::any_of(watches_, [](const auto& watch) { return watch->depth->busy(); });
}

void Service::ask(Question question) {
  const std::lock_guard lock(mutex_);
  questions_.push_back(std::move(question));
  wake_.notify_all();
}

/// Between two steps: waits for a question or until `until`, for at most a slice, and does what is due.
void Service::breathe(steady_clock::time_point until) {
  std::deque<Question> questions;
  {
    std::unique_lock lock(mutex_);
    const auto end = std::min(until, steady_clock::now() + slice);
    wake_.wait_until(lock, end, [&] { return stopping_ || !questions_.empty(); });
    questions.swap(questions_);
  }
  for (Question& question : questions) {
    // The doctor waits for his turn: he needs the sources of depth for himself.
    if (auto reply = answer(question))
      question.answer(std::move(*reply));
    else
      doctor_questions_.push_back(std::move(question));
  }
  if (!questions.empty()) publish_status();
  publish_diagnostics();
  alive_();
}

void Service::sample(Watch& watch) {
  if (prepare(watch)) {
    const auto pair = collect(watch);
    const auto evidence = pair ? watch.monitor.evaluate(*pair) : tl::unexpected(pair.error());
    if (stopping()) return;  // whatever is missing was not waited for
    if (evidence)
      evaluated(watch, *pair, *evidence);
    else
      skipped(watch, evidence.error());
  }
  if (stopping()) return;
  conclude(watch);
  publish_status();
  breathe(steady_clock::now());
}

/// Whether the pair's source of depth is good. One that is not stays so, and nothing can be said of the pair.
bool Service::prepare(Watch& watch) {
  const auto remark = watch.depth->prepare();
  const std::string& name = watch.config->name;
  if (remark && !remark->empty()) journal(5, message_ids::depth_prepared, name + ": " + *remark);
  if (remark || stopping()) return remark.has_value();
  const std::string before = watch.last_skip;
  skipped(watch, remark.error());
  watch.windows_without_evidence = windows_to_stale;
  if (watch.last_skip != before)
    journal(3, message_ids::depth_failed, name + ": " + watch.last_skip + "; this pair is not evaluated");
  return false;
}

/// Reads until a pair is complete or the window closes. Readers live no longer than this call.
Result<FramePair> Service::collect(Watch& watch) {
  const auto end = steady_clock::now() + config_.sampling.window;
  auto window = bus_.open_window(watch.topics);
  if (!window) return tl::unexpected(window.error());
  PairBuffer buffer(config_.sampling.max_time_difference,
                    {.right_image = watch.topics.right_image.has_value(), .depth = watch.topics.depth.has_value()});
  std::optional<Error> refused;
  for (auto left = config_.sampling.window; left > left.zero(); left = end - steady_clock::now()) {
    auto samples = window->wait(std::min<std::chrono::nanoseconds>(left, slice));
    if (!samples) return tl::unexpected(samples.error());
    for (Sample& sample : *samples)
      if (auto error = receive(watch, std::move(sample), buffer)) refused = std::move(error);
    while (auto pair = watch.depth->knows_cameras() ? buffer.take() : std::nullopt) {
      if (pair->image.stamp == watch.state.last_stamp) {
        refused = Error{"duplicate_frame", "the image has the stamp of the last one; does the camera stand still?"};
        continue;
      }
      if (refused && refused->code == "camera_info_mismatch") return tl::unexpected(*refused);
      return std::move(*pair);
    }
    breathe(steady_clock::now());
    if (stopping()) break;
  }
  // What its depth lacks is told when it is asked for.
  if (auto pair = buffer.take(); pair && !refused) return std::move(*pair);
  return tl::unexpected(refused ? *refused : buffer.why_none());
}

/// Puts a sample where it belongs; says why when it is of no use.
std::optional<Error> Service::receive(Watch& watch, Sample sample, PairBuffer& buffer) {
  const auto arrived = steady_clock::now();
  if (auto* left = std::get_if<LeftImage>(&sample)) {
    watch.image.last = arrived;
    buffer.add_image(std::move(left->image));
  } else if (auto* right = std::get_if<RightImage>(&sample)) {
    watch.right_image.last = arrived;
    buffer.add_right_image(std::move(right->image));
  } else if (auto* scan = std::get_if<DecodedCloud>(&sample)) {
    watch.cloud.last = arrived;
    buffer.add_scan(std::move(*scan));
  } else if (auto* depth = std::get_if<DepthImage>(&sample)) {
    watch.depth_image.last = arrived;
    buffer.add_depth(std::move(*depth));
  } else if (const auto* info = std::get_if<CameraInfo>(&sample)) {
    watch.depth->hear_left(*info);
    return contradiction(*info, watch.config->camera.camera);
  } else if (const auto* right_info = std::get_if<RightCameraInfo>(&sample)) {
    watch.depth->hear_right(right_info->info);
  } else if (const auto* malformed = std::get_if<Malformed>(&sample)) {
    ++watch.state.skipped[malformed->error.code];
    return Error{malformed->error.code, malformed->topic + ": " + malformed->error.context};
  }
  return std::nullopt;
}

void Service::evaluated(Watch& watch, const FramePair& pair, const PairMonitor::Evidence& evidence) {
  watch.windows_without_evidence = 0;
  watch.time_difference = pair.time_difference();
  watch.state.last_stamp = pair.image.stamp;
  watch.state.last_evaluated = now().wall;
  ++watch.state.evaluated;
  const DriftBaseline& baseline = watch.monitor.drift().state().baseline;
  watch.state.score = PairStatus::Score{evidence.stencil.current, evidence.stencil.best_neighbour(),
                                        baseline.pairs > 0 ? std::optional(baseline.score) : std::nullopt};
}

void Service::skipped(Watch& watch, const Error& error) {
  ++watch.windows_without_evidence;
  watch.last_skip = error.code + ": " + escape_control(error.context);
  // What is malformed was counted message by message as it came.
  if (!error.code.starts_with("malformed:")) ++watch.state.skipped[error.code];
}

/// From the evidence so far to a verdict, written down with the alert that it calls for; then to a new extrinsic.
void Service::conclude(Watch& watch) {
  PairState after = watch.state;
  after.drift = watch.monitor.drift().state();
  if (watch.windows_without_evidence >= windows_to_stale) {
    after.verdict = Verdict::not_evaluated;
    after.reason = watch.last_skip;
  } else if (watch.windows_without_evidence == 0) {
    after.verdict = shown(after.drift.verdict);
    after.reason = watch.monitor.drift().reason();
    if (after.verdict == Verdict::drifted) after.reason += "; pairs for recalibration: " + watch.monitor.progress();
  }
  write(watch, std::move(after), std::nullopt);

  const bool wanted = watch.state.verdict == Verdict::drifted && !watch.state.proposed_record;
  if (wanted && watch.state.evaluated >= watch.retry_at && watch.monitor.can_recalibrate()) [[maybe_unused]]
    const auto told = recalibrate(watch, "calibd", /*dry_run=*/false);
}

}  // namespace calib
