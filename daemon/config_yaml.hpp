#pragma once

#include <yaml-cpp/yaml.h>

#include <chrono>
#include <initializer_list>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace calib {

/// The first thing wrong in a configuration. Thrown by `ConfigNode`, caught by `parse_config`; goes no
/// further.
struct BadConfig {
  int line;  // from 1
  std::string message;
};

/// A value of the configuration that knows where it stands, read strictly: whatever is not as asked for
/// throws `BadConfig` with line, key and remedy.
class ConfigNode {
 public:
  /// The one document of `yaml`. Throws YAML::Exception when it does not parse.
  [[nodiscard]] static ConfigNode parse(const std::string& yaml);

  [[noreturn]] void refuse(std::string_view what) const;

  /// This must be a mapping of no other keys than these, each once.
  const ConfigNode& with_keys(std::initializer_list<std::string_view> allowed) const;
  [[nodiscard]] std::optional<ConfigNode> find(std::string_view key) const;
  /// Refuses when the key is missing.
  [[nodiscard]] ConfigNode at(std::string_view key) const;

  [[nodiscard]] std::vector<ConfigNode> items() const;
  /// 1 .. 4096 characters, none of them a control character.
  [[nodiscard]] std::string text() const;
  [[nodiscard]] double number(double min, double max) const;
  [[nodiscard]] int integer(int min, int max) const;
  [[nodiscard]] std::vector<double> numbers(std::size_t count, double min, double max) const;
  /// Written as a number and ms, s, min or h.
  [[nodiscard]] std::chrono::nanoseconds duration(std::chrono::nanoseconds min,
                                                  std::chrono::nanoseconds max) const;

 private:
  ConfigNode(YAML::Node node, std::string key, int line);
  [[nodiscard]] std::string plain_scalar(std::string_view needed) const;

  YAML::Node node_;
  std::string key_;  // e.g. pairs[0].camera.size; empty for the document
  int line_;
};

}  // namespace calib
