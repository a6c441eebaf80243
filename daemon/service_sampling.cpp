#include <algorithm>
#include <new>
#include <utility>

#include "camera_info_check.hpp"
#include "message_ids.hpp"
#include "service.hpp"

namespace calib {
namespace {

using namespace std::chrono_literals;

}  // namespace

void Service::sample(std::size_t index) {
  Pair& pair = *pairs_[index];
  auto measured = measure(pair);
  if (stopping()) return;  // whatever is missing was not waited for
  std::visit([&](auto& each) { conclude(index, std::move(each)); }, measured);
}

/// One window. It decides nothing: memory that runs out, and what a library throws over samples, cost the window and no
/// more. What is thrown in a decision ends the process: the next start goes on from what was written.
std::variant<Measurement, Skip> Service::measure(Pair& pair) try {
  if (const auto unprepared = prepare(pair)) return *unprepared;
  const auto began = surroundings_.clock().since_boot;
  const auto samples = collect(pair);
  if (!samples) return Skip{explained(pair, samples.error(), began)};
  const auto received = surroundings_.clock().since_boot;
  auto measurement = pair.pipeline.measure(*samples, pair.state, *pair.depth, [this] { return keep_going(); });
  if (!measurement) return Skip{measurement.error()};
  measurement->received = received;
  pair.time_difference = samples->time_difference();
  return std::move(*measurement);
} catch (const std::bad_alloc&) {
  ++pair.state.skipped[std::string(to_string(ErrorCode::out_of_memory))];
  return Skip{
      {ErrorCode::out_of_memory, "there was no memory for a pair; give calibd more (MemoryMax=), or smaller samples"}};
} catch (const std::exception& exception) {
  return Skip{{ErrorCode::internal_error, std::string("a pair could not be evaluated: ") + exception.what()}};
}

/// Why nothing arrived, where what others publish tells. Not in the first window without data: whoever has just started
/// has not heard of the others yet.
Error Service::explained(const Pair& pair, Error error, std::chrono::nanoseconds window_began) const {
  const bool silent = error.code == ErrorCode::sensor_silent || error.code == ErrorCode::right_image_missing ||
                      error.code == ErrorCode::depth_missing || error.code == ErrorCode::motion_unknown;
  if (!silent || pair.state.run.windows_without_evidence == 0) return error;
  if (const auto fault = fault_of_network(pair, window_began))
    error.context = fault->seen + ": " + fault->cause + "; " + fault->remedy;
  return error;
}

/// Why the pair's source of depth is of no use, if it is. One that failed stays so, and nothing can be said of the
/// pair.
std::optional<Skip> Service::prepare(Pair& pair) {
  const auto remark = pair.depth->prepare();
  const std::string& name = pair.config->name;
  if (remark) {
    pair.depth_failure.reset();
    if (!remark->empty()) surroundings_.log(5, message_ids::depth_prepared, name + ": " + *remark);
    return std::nullopt;
  }
  const std::string failure =
      std::string(to_string(remark.error().code)) + ": " + escape_control(remark.error().context);
  if (!stopping() && pair.depth_failure != failure) {
    pair.depth_failure = failure;
    surroundings_.log(3, message_ids::depth_failed, name + ": " + failure + "; this pair is not evaluated");
  }
  return Skip{remark.error(), PairPipeline::windows_to_stale};
}

/// Reads until a pair is complete or the window closes. Readers live no longer than this call.
Result<FramePair> Service::collect(Pair& pair) {
  const auto end = surroundings_.clock().since_boot + config_.sampling.window;
  if (const auto right = pair.depth->right_image_size())
    pair.topics.right_bound = ImageBound::exactly(*right, "the CameraInfo of depth.right_info")
                                  .with_significant_bits(pair.config->camera.bits);
  auto window = network_->open_window(pair.topics);
  if (!window) return propagate(window);
  PairBuffer buffer(config_.sampling.max_time_difference, {.right_image = pair.topics.right_image.has_value(),
                                                           .depth = pair.topics.depth.has_value(),
                                                           .turn_rate = pair.topics.motion.has_value()});
  std::optional<Error> refused;
  const auto take = [&]() -> std::optional<FramePair> {
    while (auto frames = buffer.take()) {
      if (frames->image.stamp != pair.state.last_stamp) return frames;
      refused =
          Error{ErrorCode::duplicate_frame, "the image has the stamp of the last one; does the camera stand still?"};
    }
    return std::nullopt;
  };
  for (auto left = config_.sampling.window; left > left.zero(); left = end - surroundings_.clock().since_boot) {
    auto samples = (*window)->wait(std::min<std::chrono::nanoseconds>(left, 200ms));
    if (!samples) return propagate(samples);
    for (Sample& sample : *samples)
      if (auto error = receive(pair, std::move(sample), buffer)) refused = std::move(error);
    if (pair.depth->has_cameras() && !pair.camera_info.keeps_pairs_back())
      if (auto frames = take()) return std::move(*frames);
    if (!keep_going()) break;
  }
  if (stopping()) return tl::unexpected(buffer.why_none());
  if (pair.topics.camera_info && !pair.camera_info.heard && pair.camera_info.windows_to_wait > 0 &&
      --pair.camera_info.windows_to_wait == 0)
    note(pair, {ErrorCode::camera_info_missing, pair.topics.camera_info->name +
                                                    ": no CameraInfo came, which camera.info promises; pairs are "
                                                    "evaluated without it"});
  if (pair.camera_info.contradiction) return tl::unexpected(*pair.camera_info.contradiction);
  // What its depth lacks is told when it is asked for.
  auto frames = take();
  if (frames && !refused) return std::move(*frames);
  return tl::unexpected(refused ? *refused : buffer.why_none());
}

/// Counts what was wrong in a message that is used all the same.
void Service::note(Pair& pair, const Error& remark) {
  PairStatus::Remark& noted = pair.remarks[std::string(to_string(remark.code))];
  ++noted.count;
  noted.text = escape_control(remark.context);
}

/// The frame that a message names; and its remarks.
void Service::note(Pair& pair, const std::string& topic, const MessageNotes& notes) {
  for (const Error& remark : notes.remarks) note(pair, {remark.code, topic + ": " + remark.context});
}

/// The frame of a sensor's messages, which an extrinsic that is proposed has unless the configuration names another.
void Service::note_frame(Pair& pair, const std::string& topic, const MessageNotes& notes, const FrameName& configured,
                         std::string& seen) {
  if (notes.frame_id.empty()) return;
  if (configured.is_given && configured.name != notes.frame_id)
    note(pair, {ErrorCode::frame_id_mismatch, topic + " has the frame '" + notes.frame_id + "', and " +
                                                  std::string(configured.key) + " is '" + configured.name + "'"});
  if (std::exchange(seen, notes.frame_id) != notes.frame_id) publish_extrinsics();
}

/// Puts a sample where it belongs; says why when it is of no use.
std::optional<Error> Service::receive(Pair& pair, Sample sample, PairBuffer& buffer) {
  const auto arrived = surroundings_.clock().since_boot;
  if (auto* left = std::get_if<LeftImage>(&sample)) {
    pair.image = arrived;
    note(pair, pair.topics.image, left->image.notes);
    note_frame(pair, pair.topics.image, left->image.notes, pair.config->camera.frame_id, pair.camera_frame);
    buffer.add_image(std::move(left->image));
  } else if (auto* right = std::get_if<RightImage>(&sample)) {
    pair.right_image = arrived;
    note(pair, pair.topics.right_image.value_or("the right image"), right->image.notes);
    buffer.add_right_image(std::move(right->image));
  } else if (auto* scan = std::get_if<DecodedCloud>(&sample)) {
    pair.cloud = arrived;
    note(pair, pair.topics.cloud, scan->notes);
    note_frame(pair, pair.topics.cloud, scan->notes, pair.config->lidar.frame_id, pair.lidar_frame);
    buffer.add_scan(std::move(*scan));
  } else if (auto* depth = std::get_if<DepthImage>(&sample)) {
    pair.depth_image = arrived;
    note(pair, pair.topics.depth ? pair.topics.depth->name : "the depth image", depth->notes);
    buffer.add_depth(std::move(*depth));
  } else if (const auto* rate = std::get_if<TurnRate>(&sample)) {
    pair.motion = arrived;
    buffer.add_turn_rate(*rate);
  } else if (const auto* info = std::get_if<CameraInfo>(&sample)) {
    pair.depth->set_left_camera_info(*info);
    pair.camera_info.heard = true;
    const auto found = contradiction(*info, pair.config->camera.camera);
    pair.camera_info.contradiction = found ? std::optional(error_of(*found)) : std::nullopt;
  } else if (const auto* right_info = std::get_if<RightCameraInfo>(&sample)) {
    pair.depth->set_right_camera_info(right_info->info);
  } else if (const auto* malformed = std::get_if<Malformed>(&sample)) {
    if (pair.topics.camera_info && malformed->topic == pair.topics.camera_info->name)
      pair.camera_info.heard = true;                                      // and says nothing
    ++pair.state.skipped[std::string(to_string(malformed->error.code))];  // a counter, saved with the next decision
    return Error{malformed->error.code, malformed->topic + ": " + malformed->error.context};
  }
  return std::nullopt;
}

}  // namespace calib
