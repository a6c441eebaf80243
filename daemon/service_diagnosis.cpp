#include <algorithm>

#include "service.hpp"
#include "topic_probe.hpp"

namespace calib {

ControlReply Service::answer(const DiagnosisRequest& request, const PendingRequest&) try {
  if (request.pair)
    if (const auto pair = find(*request.pair); !pair) return pair.error();
  DiagnosisReport report = diagnose_pairs(request.pair);
  if (stopping()) return Error{ErrorCode::failed, "calibd ends"};  // in the middle of it
  return report;
} catch (const std::exception& exception) {
  return Error{ErrorCode::failed, exception.what()};
}

/// Between two pairs, when nothing else uses the depth sources. Of the pair of that name, or of all.
DiagnosisReport Service::diagnose_pairs(const std::optional<std::string>& name) {
  std::set<std::string> image_topics;
  for (const auto& pair : pairs_) {
    image_topics.insert(pair->topics.image);
    if (pair->topics.right_image) image_topics.insert(*pair->topics.right_image);
  }
  DiagnosisReport report;
  for (const auto& pair : pairs_) {
    if ((name && *name != pair->config->name) || stopping()) continue;
    diagnose_pair(
        {.dds = config_.dds,
         .sampling = config_.sampling,
         .pair = *pair->config,
         .topics = pair->topics,
         .T_camera_lidar = pair->state.T_camera_lidar,
         .image_topics_in_use = image_topics,
         .picture_folder = config_.state_dir / "doctor",
         .verdict = std::string(to_string(status_of(*pair).verdict))},
        *network_, *pair->depth, [this] { return keep_going(); }, report);
  }
  return report;
}

/// Why nothing arrives on topics of the pair, by what is published: a wrong topic, type or quality of service, or
/// nobody there. Nothing when that explains it. `since`: topics on which something arrived later are in order.
std::optional<Finding> Service::fault_of_network(const Pair& pair, std::chrono::nanoseconds since) const {
  auto writers = network_->remote_writers();
  if (!writers) return std::nullopt;
  PairObservation seen{.camera = pair.config->camera.camera, .depth_kind = depth_kind(pair.config->depth)};
  seen.pair = pair.config->name;
  seen.domain = config_.dds.domain;
  seen.interface = config_.dds.interface;
  seen.listened = config_.sampling.window;
  seen.writers = std::move(*writers);
  const std::map<std::string_view, std::optional<std::chrono::nanoseconds>> arrived{{"image", pair.image},
                                                                                    {"right_image", pair.right_image},
                                                                                    {"depth_topic", pair.depth_image},
                                                                                    {"motion_topic", pair.motion},
                                                                                    {"cloud", pair.cloud}};
  for (TopicObservation& topic : topics_to_probe(pair.topics, pair.topics.camera_info.has_value())) {
    const auto found = arrived.find(topic.check);
    if (found == arrived.end() || (found->second && *found->second >= since)) continue;
    seen.topics.push_back(std::move(topic));
  }
  for (const auto& other : pairs_) {
    seen.topics_in_use.insert({other->topics.image, other->topics.cloud});
    if (other->topics.right_image) seen.topics_in_use.insert(*other->topics.right_image);
  }
  std::vector<Finding> findings;
  diagnose_samples(seen, findings);
  const auto problem = std::ranges::find_if(findings, [&](const Finding& finding) {
    return finding.result == FindingResult::problem && arrived.contains(finding.check);
  });
  return problem == findings.end() ? std::nullopt : std::optional(std::move(*problem));
}

}  // namespace calib
