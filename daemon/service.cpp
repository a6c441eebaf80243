#include "service.hpp"

#include <time.h>

#include <algorithm>
#include <new>

#include "journal.hpp"
#include "message_ids.hpp"
#include "pair_topics.hpp"

namespace calib {
namespace {

using nlohmann::json;
using std::chrono::steady_clock;

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
    return Error{ErrorCode::camera_info_mismatch, "CameraInfo is for " + std::to_string(info.width) + " x " +
                                                      std::to_string(info.height) + " pixels; correct camera.size"};
  const bool rectified = camera.model() == CameraModel::rectified;
  const std::array<double, 4> theirs = rectified ? std::array{info.P[0], info.P[5], info.P[2], info.P[6]}
                                                 : std::array{info.K[0], info.K[4], info.K[2], info.K[5]};
  const std::array<double, 4> ours{camera.fx(), camera.fy(), camera.cx(), camera.cy()};
  for (std::size_t i = 0; i < ours.size(); ++i)
    if (std::abs(theirs[i] - ours[i]) > 0.5)
      return Error{ErrorCode::camera_info_mismatch, std::string("CameraInfo's ") + (rectified ? "P" : "K") +
                                                        " differs from camera.intrinsics; correct the configuration"};
  return std::nullopt;
}

/// What `work` returns, which decides nothing: memory that runs out, and what a library throws over samples, cost the
/// window and no more. What is thrown in a decision ends the process: the next start goes on from what was written.
template <typename Work>
Result<void> contained(PairWatch& pair, Work work) {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    pair.count_skipped(ErrorCode::out_of_memory);
    return fail(ErrorCode::out_of_memory,
                "there was no memory for a pair; give calibd more (MemoryMax=), or smaller samples");
  } catch (const std::exception& exception) {
    return fail(ErrorCode::internal_error, std::string("a pair could not be evaluated: ") + exception.what());
  }
}

}  // namespace

Moment now() { return {read_clock(CLOCK_REALTIME), read_clock(CLOCK_BOOTTIME)}; }

std::string evidence_sha256(const PairConfig& pair, const Provenance& provenance) {
  std::string measured_with = pair.evidence_text + "software:" + provenance.software_sha256 + '\n';
  if (const auto* onnx = std::get_if<OnnxDepthConfig>(&pair.depth))
    measured_with += "model:" + onnx->descriptor_sha256 + '\n';
  return sha256_hex(measured_with);
}

Result<std::unique_ptr<Service>> Service::make(Config config, Ledger ledger, Bus bus) {
  std::unique_ptr<Service> service(new Service(std::move(config), std::move(ledger), std::move(bus)));
  for (PairConfig& pair : service->config_.pairs)
    if (auto* onnx = std::get_if<OnnxDepthConfig>(&pair.depth)) onnx->descriptor_sha256 = sha256_of_file(onnx->model);
  if (const auto& missing = service->ledger_.records_missing())
    journal(3, message_ids::records_missing, *missing + "; calibd goes on with the records that there are");
  // Alerts that were written but perhaps not sent, and extrinsics that late readers must see.
  const auto latest = service->ledger_.latest_alerts(32);
  if (!latest) return propagate(latest);
  for (const Error& unreadable : latest->unreadable)
    journal(4, message_ids::store_failed, unreadable.context + "; it is left where it is, and not sent");
  for (const DriftAlert& alert : latest->alerts)
    if (auto sent = service->bus_.publish_alert(alert); !sent) return propagate(sent);
  for (const PairConfig& pair : service->config_.pairs)
    if (auto taken = service->take_over(pair); !taken) return propagate(taken);
  service->publish_extrinsics();
  service->collect_status();
  return service;
}

Result<void> Service::run(const std::function<void()>& alive) {
  alive_ = alive;
  auto next = steady_clock::now();
  while (!stopping()) {
    for (auto& watch : watches_) {
      if (!stopping()) sample(*watch);
      if (const auto& failure = watch->pair->store_failure(); failure && failure->code == ErrorCode::store_moved)
        return tl::unexpected(*failure);
      see_doctor();
    }
    next = std::max(next + config_.sampling.period, steady_clock::now());
    while (steady_clock::now() < next && !stopping()) {
      breathe(next);
      see_doctor();
    }
  }
  return {};
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

void Service::ask(Question question) {
  const std::lock_guard lock(mutex_);
  if (questions_.size() >= most_questions)
    std::erase_if(questions_, [](const Question& waiting) { return waiting.asker_left->load(); });
  if (questions_.size() >= most_questions) {
    question.answer(refusal("failed", "too many questions wait; ask later"));
    return;
  }
  questions_.push_back(std::move(question));
  wake_.notify_all();
}

/// While one step of the pipeline goes on that must not be entered a second time: feeds the watchdog, and says whether
/// to go on.
bool Service::keep_going() {
  if (const auto time = steady_clock::now(); time >= last_alive_ + slice) {
    last_alive_ = time;
    alive_();
  }
  return !stopping();
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
  if (!questions.empty()) collect_status();
  alive_();
}

void Service::sample(Watch& watch) {
  const auto evaluated = contained(*watch.pair, [&] { return evaluate(watch); });
  if (stopping()) return;  // whatever is missing was not waited for
  if (!evaluated && evaluated.error().code != ErrorCode::not_prepared) watch.pair->skip(evaluated.error());
  watch.pair->conclude();
  collect_status();
  breathe(steady_clock::now());
}

/// One window.
Result<void> Service::evaluate(Watch& watch) {
  if (!prepare(watch)) return fail(ErrorCode::not_prepared, "");
  const auto pair = collect(watch);
  if (!pair) return propagate(pair);
  auto evaluated = watch.pair->evaluate(*pair);
  if (evaluated) watch.time_difference = pair->time_difference();
  return evaluated;
}

/// Whether the pair's source of depth is good. One that is not stays so, and nothing can be said of the pair.
bool Service::prepare(Watch& watch) {
  const auto remark = watch.depth->prepare();
  const std::string& name = watch.config->name;
  if (remark && !remark->empty()) journal(5, message_ids::depth_prepared, name + ": " + *remark);
  if (remark || stopping()) return remark.has_value();
  const std::string before = watch.pair->last_skip();
  watch.pair->skip(remark.error(), PairWatch::windows_to_stale);
  if (watch.pair->last_skip() != before)
    journal(3, message_ids::depth_failed, name + ": " + watch.pair->last_skip() + "; this pair is not evaluated");
  return false;
}

/// Reads until a pair is complete or the window closes. Readers live no longer than this call.
Result<FramePair> Service::collect(Watch& watch) {
  const auto end = steady_clock::now() + config_.sampling.window;
  if (const auto right = watch.depth->right_size())
    watch.topics.right_bound = ImageBound::exactly(*right, "the CameraInfo of depth.right_info");
  auto window = bus_.open_window(watch.topics);
  if (!window) return propagate(window);
  PairBuffer buffer(config_.sampling.max_time_difference, {.right_image = watch.topics.right_image.has_value(),
                                                           .depth = watch.topics.depth.has_value(),
                                                           .turn_rate = watch.topics.motion.has_value()});
  std::optional<Error> refused;
  for (auto left = config_.sampling.window; left > left.zero(); left = end - steady_clock::now()) {
    auto samples = window->wait(std::min<std::chrono::nanoseconds>(left, slice));
    if (!samples) return propagate(samples);
    for (Sample& sample : *samples)
      if (auto error = receive(watch, std::move(sample), buffer)) refused = std::move(error);
    while (auto pair = watch.depth->knows_cameras() ? buffer.take() : std::nullopt) {
      if (pair->image.stamp == watch.pair->state().last_stamp) {
        refused =
            Error{ErrorCode::duplicate_frame, "the image has the stamp of the last one; does the camera stand still?"};
        continue;
      }
      if (refused && refused->code == ErrorCode::camera_info_mismatch) return tl::unexpected(*refused);
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
  } else if (const auto* rate = std::get_if<TurnRate>(&sample)) {
    watch.motion.last = arrived;
    buffer.add_turn_rate(*rate);
  } else if (const auto* info = std::get_if<CameraInfo>(&sample)) {
    watch.depth->hear_left(*info);
    return contradiction(*info, watch.config->camera.camera);
  } else if (const auto* right_info = std::get_if<RightCameraInfo>(&sample)) {
    watch.depth->hear_right(right_info->info);
  } else if (const auto* malformed = std::get_if<Malformed>(&sample)) {
    watch.pair->count_skipped(malformed->error.code);
    return Error{malformed->error.code, malformed->topic + ": " + malformed->error.context};
  }
  return std::nullopt;
}

Result<void> Service::take_over(const PairConfig& pair) {
  auto depth = std::make_unique<DepthSource>(pair, [this] {
    breathe(steady_clock::now());
    return !stopping();
  });
  DepthSource* const source = depth.get();
  const PairListener listener{
      .alert =
          [this, name = pair.name](const DriftAlert& alert) {
            if (auto sent = bus_.publish_alert(alert); !sent)
              journal(4, message_ids::bus_failed,
                      name + ": " + sent.error().context + "; the alert is kept and sent at the next start");
            collect_status();  // a recalibration may follow, and take its time
          },
      .journal = journal,
      .extrinsic_changed = [this] { publish_extrinsics(); },
      .keep_going = [this] { return keep_going(); }};
  auto watch = PairWatch::take_over(config_, pair, evidence_sha256(pair, ledger_.provenance()), std::move(depth),
                                    ledger_, now, listener);
  if (!watch) return propagate(watch);
  watches_.push_back(std::make_unique<Watch>(
      Watch{.config = &pair, .topics = topics_of(pair), .pair = std::move(*watch), .depth = source}));
  return {};
}

std::optional<json> Service::answer(const Question& question) {
  const auto& request = question.request;
  const std::string what = request["request"].get<std::string>();
  const std::string name =
      request.contains("pair") && request["pair"].is_string() ? request["pair"].get<std::string>() : "";
  const auto found = std::ranges::find_if(watches_, [&](const auto& watch) { return watch->config->name == name; });
  if (what == "doctor") {
    constexpr std::size_t most_waiting = 16;
    if (found == watches_.end() && !request.value("pair", json()).is_null())
      return refusal("not_found", "there is no pair '" + escape_control(name) + "'");
    if (doctor_questions_.size() >= most_waiting) return refusal("failed", "too many wait for the doctor; ask later");
    return std::nullopt;
  }
  if (what != "recalibrate" && what != "accept" && what != "rollback")
    return refusal("bad_request", "the requests are status, records, doctor, recalibrate, accept and rollback");
  if (!question.peer.may_change)
    return refusal("denied", "only root, the daemon's user and members of its group may ask for changes");
  if (found == watches_.end()) return refusal("not_found", "there is no pair '" + escape_control(name) + "'");
  const std::string asked_by = "uid:" + std::to_string(question.peer.uid);
  PairWatch& pair = *(*found)->pair;
  if (what == "accept") return pair.accept(asked_by);
  if (what == "rollback") return pair.roll_back(request.value("to", json()), asked_by);
  return pair.recalibrate(asked_by, request.value("dry_run", json(false)) == true);
}

}  // namespace calib
