#pragma once

#include <onnxruntime_cxx_api.h>

#include <optional>
#include <string>
#include <vector>

#include "calib/depth_model.hpp"
#include "calib/depth_onnx.hpp"
#include "network_image.hpp"

namespace calib {

/// A network in ONNX Runtime: read when it is needed.
class OnnxNetwork {
 public:
  OnnxNetwork(const DepthModel& model, const OnnxSettings& settings);

  /// Reads the network unless it is there already. Fails with `depth_failed`.
  [[nodiscard]] Result<void> load();
  /// Until the next `run`: drops the network unless it is to be kept.
  void rest();

  /// The network's map for an input of the placement's size, after `load`. Fails with `depth_failed` also where a value
  /// is not a number.
  [[nodiscard]] Result<NetworkMap> run(std::vector<float> tensor, const Placement& placement);

  /// What became of the execution provider that was asked for; empty when it is as asked.
  [[nodiscard]] const std::string& remark() const { return remark_; }

  /// From any thread; `run` fails from then on.
  void cancel() { Ort::ThrowOnError(Ort::GetApi().RunOptionsSetTerminate(run_options_)); }

 private:
  [[nodiscard]] Ort::SessionOptions session_options() const;
  void open(const std::string& bytes);
  [[nodiscard]] Result<void> check_input();
  [[nodiscard]] Result<void> check_output();
  [[nodiscard]] Result<NetworkMap> map_of(const Ort::Value& value) const;
  [[nodiscard]] tl::unexpected<Error> refuse(const std::string& what) const;

  const DepthModel model_;
  const OnnxSettings settings_;
  Ort::Env env_;
  Ort::RunOptions run_options_;
  std::optional<Ort::Session> session_;
  std::string remark_;
};

}  // namespace calib
