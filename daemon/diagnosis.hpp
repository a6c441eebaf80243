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

/// A picture of a pair: the image with the points of the cloud, and depth below it.
struct Overlay {
  std::string pair;
  std::filesystem::path file;  // PNG
};

struct DiagnosisReport {
  std::vector<PairFinding> checks;
  std::vector<Overlay> overlays;
};

/// What a diagnosis needs to know of a pair. All that is referred to outlives the call.
struct DiagnosisInput {
  const DdsConfig& dds;
  const SamplingConfig& sampling;
  const PairConfig& pair;
  const PairTopics& topics;
  const RigidTransform& T_camera_lidar;             // in force
  const std::set<std::string>& other_image_topics;  // the images of all pairs: never what another topic was meant to be
  std::filesystem::path picture_folder;             // is made when it does not exist
};

/// Listens to the topics of a pair for up to five seconds, estimates depth, and adds what it found to `report`: the
/// findings of `diagnose`, and an overlay when samples belong together. A picture that cannot be written is a finding.
/// `depth` learns the CameraInfo that arrived; nothing else of the pair changes. `keep_going` is called several times a
/// second; false ends listening, and what follows is judged by what has arrived.
void diagnose_pair(const DiagnosisInput& input, Network& network, DepthSource& depth,
                   const std::function<bool()>& keep_going, DiagnosisReport& report);

}  // namespace calib
