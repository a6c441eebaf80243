#include "onnx_network.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>

#include "model_file.hpp"

namespace calib {
namespace {

/// ONNX Runtime prints what it has to say unless somebody takes it; what matters comes as an error too.
void ORT_API_CALL say_nothing(void*, OrtLoggingLevel, const char*, const char*, const char*, const char*) {}

std::string first_line(const Ort::Exception& exception) {
  const std::string text = exception.what();
  return text.substr(0, text.find('\n'));
}

std::string lower_case(std::string text) {
  std::ranges::transform(text, text.begin(), [](unsigned char c) { return std::tolower(c); });
  return text;
}

std::string upper_case(std::string text) {
  std::ranges::transform(text, text.begin(), [](unsigned char c) { return std::toupper(c); });
  return text;
}

/// "CUDA", "cuda" and "CUDAExecutionProvider" are the same.
std::string plain_provider(const std::string& name) {
  const std::string plain = lower_case(name);
  return plain.substr(0, plain.find("executionprovider"));
}

/// Throws when it is not to be had.
void append_provider(Ort::SessionOptions& options, const std::string& plain) {
  if (plain == "cuda") return static_cast<void>(options.AppendExecutionProvider_CUDA({}));
  if (plain == "tensorrt") return static_cast<void>(options.AppendExecutionProvider_TensorRT({}));
  std::string names;
  for (const std::string& available : Ort::GetAvailableProviders()) {
    const std::string name = available.substr(0, plain.size());
    names += (names.empty() ? "" : ", ") + plain_provider(available);
    if (plain_provider(available) != plain) continue;
    // Here ONNX Runtime wants some names in capitals (AZURE, XNNPACK) and some as they are (OpenVINO).
    try {
      options.AppendExecutionProvider(name);
    } catch (const Ort::Exception&) {
      options.AppendExecutionProvider(upper_case(name));
    }
    return;
  }
  throw Ort::Exception("this ONNX Runtime has " + names, ORT_INVALID_ARGUMENT);
}

constexpr int any = -1;  // as ONNX Runtime marks sides that may vary

std::string shape_text(const std::vector<std::int64_t>& shape) {
  std::string text;
  for (const std::int64_t side : shape) text += (text.empty() ? "" : " x ") + (side < 0 ? "any" : std::to_string(side));
  return text.empty() ? "a single number" : text;
}

std::array<std::int64_t, 4> input_shape(const NetworkInput& input, const Placement& placement) {
  if (input.layout == TensorLayout::nchw) return {1, input.channels(), placement.height, placement.width};
  return {1, placement.height, placement.width, input.channels()};
}

/// Height and width in a shape of rank 3 or 4 that holds one map.
std::optional<std::pair<std::int64_t, std::int64_t>> map_size(const std::vector<std::int64_t>& shape) {
  const auto one = [&](std::size_t i) { return shape[i] == 1; };
  if (shape.size() == 3 && one(0)) return std::pair(shape[1], shape[2]);
  if (shape.size() == 4 && one(0) && one(1)) return std::pair(shape[2], shape[3]);
  if (shape.size() == 4 && one(0) && one(3)) return std::pair(shape[1], shape[2]);
  return std::nullopt;
}

constexpr std::string_view map_shapes = "1 x height x width, 1 x 1 x height x width or 1 x height x width x 1";

const OrtApiBase* onnx_runtime = nullptr;

Result<void> open_onnx_runtime() {
  constexpr const char* name = "libonnxruntime.so.1";
  const auto refuse = [&](const std::string& why) {
    return fail(ErrorCode::bad_config, "depth from a network needs the package calibd-onnx: " + std::string(name) +
                                           " cannot be used: " + why + "; install it (ONNX Runtime 1." +
                                           std::to_string(ORT_API_VERSION) +
                                           " or newer), or use another depth source than onnx");
  };
  void* library = dlopen(name, RTLD_NOW | RTLD_LOCAL);
  if (library == nullptr) return refuse(dlerror());
  const auto entry = reinterpret_cast<decltype(&OrtGetApiBase)>(dlsym(library, "OrtGetApiBase"));
  if (entry == nullptr) return refuse("it has no OrtGetApiBase");
  onnx_runtime = entry();
  const OrtApi* api = onnx_runtime->GetApi(ORT_API_VERSION);
  if (api == nullptr) return refuse(std::string("it is ") + onnx_runtime->GetVersionString());
  Ort::InitApi(api);
  return {};
}

}  // namespace

Result<void> load_onnx_runtime() {
  static const Result<void> loaded = open_onnx_runtime();
  return loaded;
}

OnnxNetwork::OnnxNetwork(const DepthModel& model, const OnnxSettings& settings)
    : model_(model), settings_(settings), env_(ORT_LOGGING_LEVEL_FATAL, "calib", say_nothing, nullptr) {}

tl::unexpected<Error> OnnxNetwork::refuse(const std::string& what) const {
  return fail(ErrorCode::depth_failed, model_.file.string() + ": " + what);
}

Ort::SessionOptions OnnxNetwork::session_options() const {
  Ort::SessionOptions options;
  options.SetIntraOpNumThreads(settings_.threads);
  options.SetInterOpNumThreads(1);
  options.SetDeterministicCompute(true);
  options.AddConfigEntry("session.intra_op.allow_spinning", settings_.spinning ? "1" : "0");
  // Not ONNX Runtime's own format, which is not looked into for other files.
  options.AddConfigEntry("session.load_model_format", "ONNX");
  if (!settings_.memory_arena) options.DisableCpuMemArena().DisableMemPattern();
  return options;
}

void OnnxNetwork::open(const std::string& bytes) {
  remark_.clear();
  if (const std::string provider = plain_provider(settings_.execution_provider); provider != "cpu") {
    try {
      Ort::SessionOptions options = session_options();
      append_provider(options, provider);
      session_.emplace(env_, bytes.data(), bytes.size(), options);
      return;
    } catch (const Ort::Exception& exception) {
      remark_ = "execution provider " + provider + " is not available (" + first_line(exception) + "): CPU is used";
    }
  }
  session_.emplace(env_, bytes.data(), bytes.size(), session_options());
}

Result<void> OnnxNetwork::load() {
  if (session_) return {};
  const auto bytes = read_model_file(model_);
  if (!bytes) return propagate(bytes);
  try {
    open(*bytes);
    auto checked = check_input();
    if (checked) checked = check_output();
    if (!checked) session_.reset();
    return checked;
  } catch (const Ort::Exception& exception) {
    session_.reset();
    return refuse(std::string("ONNX Runtime ") + onnx_runtime->GetVersionString() + " cannot load it: " +
                  first_line(exception) + "; export the network again with operators that this version has");
  }
}

void OnnxNetwork::rest() {
  if (!settings_.keep_session) session_.reset();
}

Result<void> OnnxNetwork::check_input() {
  std::string names;
  Ort::AllocatorWithDefaultOptions allocator;
  for (std::size_t i = 0; i < session_->GetInputCount(); ++i)
    names += (i == 0 ? "" : ", ") + std::string(session_->GetInputNameAllocated(i, allocator).get());
  const NetworkInput& input = model_.input;
  const std::string descriptor = model_.descriptor.string();
  if (session_->GetInputCount() != 1)
    return refuse("takes " + std::to_string(session_->GetInputCount()) + " inputs (" + names +
                  "); export it with the image as the only one");
  if (names != input.name)
    return refuse("has no input " + input.name + "; write " + names + " as input.name in " + descriptor);
  const Ort::TypeInfo type = session_->GetInputTypeInfo(0);
  if (type.GetONNXType() != ONNX_TYPE_TENSOR ||
      type.GetTensorTypeAndShapeInfo().GetElementType() != ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT)
    return refuse("its input " + input.name + " is no tensor of 32-bit floats; export it with one");
  const auto shape = type.GetTensorTypeAndShapeInfo().GetShape();
  // A size that follows the image's is for ONNX Runtime to check at each run.
  const bool follows_image = input.fit == Fit::lower_bound || input.fit == Fit::upper_bound;
  const int width = follows_image ? any : input.width, height = follows_image ? any : input.height;
  const auto wanted = input_shape(input, {width, height, 0, 0, 0, 0});
  const auto agree = [](std::int64_t is, std::int64_t should_be) { return is < 0 || should_be < 0 || is == should_be; };
  const bool fits = shape.size() == wanted.size() && std::ranges::equal(shape, wanted, agree);
  if (fits) return {};
  return refuse("its input " + input.name + " is " + shape_text(shape) + " where " + descriptor + " asks for " +
                shape_text({wanted.begin(), wanted.end()}) + "; correct input.layout, size or channel_order there");
}

Result<void> OnnxNetwork::check_output() {
  std::string names;
  Ort::AllocatorWithDefaultOptions allocator;
  for (std::size_t i = 0; i < session_->GetOutputCount(); ++i) {
    const std::string name = session_->GetOutputNameAllocated(i, allocator).get();
    names += (i == 0 ? "" : ", ") + name;
    if (name != model_.output.name) continue;
    const Ort::TypeInfo type = session_->GetOutputTypeInfo(i);
    if (type.GetONNXType() != ONNX_TYPE_TENSOR ||
        type.GetTensorTypeAndShapeInfo().GetElementType() != ONNX_TENSOR_ELEMENT_DATA_TYPE_FLOAT)
      return refuse("its output " + name + " is no tensor of 32-bit floats; export it with one");
    return {};
  }
  return refuse("has no output " + model_.output.name + "; its outputs are " + names +
                ": write one as output.name in " + model_.descriptor.string());
}

Result<NetworkMap> OnnxNetwork::run(std::vector<float> tensor, const Placement& placement) {
  try {
    const auto shape = input_shape(model_.input, placement);
    const Ort::Value input =
        Ort::Value::CreateTensor<float>(Ort::MemoryInfo::CreateCpu(OrtDeviceAllocator, OrtMemTypeCPU), tensor.data(),
                                        tensor.size(), shape.data(), shape.size());
    const char *const input_name = model_.input.name.c_str(), *const output_name = model_.output.name.c_str();
    const auto outputs = session_->Run(run_options_, &input_name, &input, 1, &output_name, 1);
    return map_of(outputs.front());
  } catch (const Ort::Exception& exception) {
    return refuse("ONNX Runtime cannot run it on an input of " + std::to_string(placement.width) + " x " +
                  std::to_string(placement.height) + ": " + first_line(exception));
  }
}

Result<NetworkMap> OnnxNetwork::map_of(const Ort::Value& value) const {
  const auto shape = value.GetTensorTypeAndShapeInfo().GetShape();
  const auto size = map_size(shape);
  if (!size || size->first < 1 || size->second < 1)
    return refuse("its output " + model_.output.name + " is " + shape_text(shape) + "; " + std::string(map_shapes) +
                  " is needed: choose another output.name in " + model_.descriptor.string() + ", or export it so");
  const float* const values = value.GetTensorData<float>();
  NetworkMap map{
      static_cast<int>(size->second), static_cast<int>(size->first), {values, values + size->first * size->second}};
  if (std::ranges::any_of(map.values, [](float number) { return std::isnan(number); }))
    return refuse("its output " + model_.output.name + " holds what is no number (NaN); check scale, mean and std in " +
                  model_.descriptor.string() + ", or export the network in 32-bit floats throughout");
  return map;
}

}  // namespace calib
