#include "depth/depth_config.hpp"

#include <type_traits>

namespace calib {
namespace {

template <typename... Kinds>
DepthConfig read_named(const ConfigNode& node, const CameraConfig& camera, std::type_identity<std::variant<Kinds...>>) {
  const ConfigNode source = node.at("source");
  const std::string name = source.text();
  std::optional<DepthConfig> read;
  std::string names;
  const auto try_kind = [&]<typename Kind>(std::type_identity<Kind>) {
    names += (names.empty() ? "" : ", ") + std::string(Kind::kind.name);
    if (name == Kind::kind.name) read = Kind::read(node, camera);
  };
  (try_kind(std::type_identity<Kinds>()), ...);
  if (!read) source.refuse("is none of: " + names);
  return std::move(*read);
}

}  // namespace

const DepthSourceKind& depth_kind(const DepthConfig& source) {
  return std::visit([](const auto& kind) -> const DepthSourceKind& { return kind.kind; }, source);
}

DepthConfig read_depth_config(const ConfigNode& node, const CameraConfig& camera) {
  return read_named(node, camera, std::type_identity<DepthConfig>());
}

void add_topics(const DepthConfig& source, const Camera& camera, PairTopics& topics) {
  topics.colour = depth_kind(source).colour;
  std::visit([&](const auto& kind) { kind.add_topics(camera, topics); }, source);
}

Result<void> pin_files(DepthConfig& source) {
  return std::visit([](auto& kind) { return kind.pin_files(); }, source);
}

std::string pinned_text(const DepthConfig& source) {
  return std::visit([](const auto& kind) { return kind.pinned_text(); }, source);
}

bool has_cameras(const DepthConfig& source, const Camera& camera, const StereoCameraInfo& infos) {
  return std::visit([&](const auto& kind) { return kind.has_cameras(camera, infos); }, source);
}

Result<std::unique_ptr<DepthEstimator>> make_estimator(const DepthConfig& source, const Camera& camera,
                                                       const StereoCameraInfo& infos) {
  return std::visit([&](const auto& kind) { return kind.make_estimator(camera, infos); }, source);
}

}  // namespace calib
