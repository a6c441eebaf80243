#pragma once

#include <filesystem>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "config.hpp"
#include "depth_source.hpp"
#include "findings.hpp"
#include "network.hpp"

namespace calib {

struct PairFinding {
  std::string pair;
  Finding finding;
};

/// A picture of a pair: the image with the projected points of the cloud, and below it the depth map. Above them stand
/// the pair, its topics, stamps and ages of the frames, what was found, and the colours of ranges.
struct Overlay {
  std::string pair;
  std::filesystem::path file;  // PNG
};

struct DiagnosisReport {
  std::vector<PairFinding> checks;
  std::vector<Overlay> overlays;
};

/// What a diagnosis reads of a pair. All references outlive the call.
struct DiagnosisInput {
  const DdsConfig& dds;
  const SamplingConfig& sampling;
  const PairConfig& pair;
  const PairTopics& topics;
  const RigidTransform& T_camera_lidar;              // in force
  const std::set<std::string>& image_topics_in_use;  // of all pairs: not suggested in place of a wrong topic
  std::filesystem::path picture_folder;              // created if it does not exist
  std::string verdict = {};                          // of the pair, for the picture's title; empty: not known
};

/// Listens to the topics of a pair for up to five seconds, estimates depth, and appends to `report`: the findings of
/// `diagnose`, and an overlay if a pair of samples arrived. A picture that cannot be written is a finding. `depth` gets
/// the CameraInfo that arrived; nothing else of the pair changes. `keep_going` is called several times a second while
/// the pair is listened to; false ends listening.
void diagnose_pair(const DiagnosisInput& input, Network& network, DepthSource& depth,
                   const std::function<bool()>& keep_going, DiagnosisReport& report);

}  // namespace calib
