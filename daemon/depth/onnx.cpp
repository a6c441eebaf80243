#include "depth/onnx.hpp"

#include "calib/sha256.hpp"
#include "config_values.hpp"

namespace calib {
namespace {

/// Empty when the file cannot be read.
std::string sha256_of_file(const std::filesystem::path& file) {
  const auto text = read_config_text(file);
  return text ? sha256_hex(*text) : "";
}

}  // namespace

constinit const DepthSourceKind OnnxDepthConfig::kind{
    .name = "onnx",
    .is_metric = false,
    .is_monocular = true,
    .colour = Colour::rgb,
    .remedies = {.few_valid = "is it the right model, topic and range_m?",
                 .inverted = "correct output.semantics in the model's descriptor: depth and inverse depth are confused",
                 .wrong_scale = "correct the unit of depth"},
    .preparation_failure = DepthSourceKind::PreparationFailure{
        .code = ErrorCode::depth_model_refused,
        .cause = "the network's file, its descriptor or its golden pair was altered, or is not the one that was meant",
        .remedy = "put back the network that the descriptor was written for, or write a descriptor for this one; then "
                  "restart calibd"}};

OnnxDepthConfig OnnxDepthConfig::read(const ConfigNode& node, const CameraConfig&) {
  if (!has_onnx())
    node.at("source").refuse("onnx needs a calibd that was built with ONNX Runtime; choose stereo or topic");
  if (const auto range = node.find("range_m"))
    range->refuse("is for stereo and topic; a network's range stands in its descriptor");
  node.with_keys(
      {"source", "timeout", "model", "threads", "spinning", "memory_arena", "keep_session", "execution_provider"});
  OnnxDepthConfig onnx{.model = read_absolute_path(node.at("model")), .settings = {}};
  OnnxSettings& settings = onnx.settings;
  if (const auto threads = node.find("threads")) settings.threads = threads->integer(1, 64);
  if (const auto spinning = node.find("spinning")) settings.spinning = spinning->boolean();
  if (const auto arena = node.find("memory_arena")) settings.memory_arena = arena->boolean();
  if (const auto keep = node.find("keep_session")) settings.keep_session = keep->boolean();
  if (const auto provider = node.find("execution_provider")) {
    settings.execution_provider = provider->text();
    if (!is_name(settings.execution_provider, "ABCDEFGHIJKLMNOPQRSTUVWXYZ_"))
      provider->refuse("needs ONNX Runtime's name of an execution provider, such as cpu or cuda");
  }
  return onnx;
}

Result<void> OnnxDepthConfig::pin_files() {
  descriptor_sha256 = sha256_of_file(model);
  return load_onnx_runtime();
}

Result<std::unique_ptr<DepthEstimator>> OnnxDepthConfig::make_estimator(const Camera& camera,
                                                                        const StereoCameraInfo&) const {
  // Evidence from two networks must not pass for evidence from one.
  if (!descriptor_sha256.empty() && sha256_of_file(model) != descriptor_sha256)
    return fail(ErrorCode::depth_failed, model.string() + " has changed since calibd started; restart calibd");
  return make_onnx_depth(model, camera, settings);
}

}  // namespace calib
