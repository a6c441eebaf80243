#pragma once

#include <yaml-cpp/yaml.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "calib/result.hpp"

namespace calib {

/// The first thing wrong in a configuration. Thrown by `ConfigNode`, caught by `parse_config_text`; goes no further.
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
  /// Refuses when this is no mapping.
  [[nodiscard]] std::optional<ConfigNode> find(std::string_view key) const;
  /// Refuses when the key is missing.
  [[nodiscard]] ConfigNode at(std::string_view key) const;

  /// Every key with its value, of a mapping whose keys are free. Refuses when this is no mapping, and a key that is
  /// given twice or is no word.
  [[nodiscard]] std::vector<std::pair<std::string, ConfigNode>> entries() const;
  [[nodiscard]] std::vector<ConfigNode> items() const;
  /// 1 .. 4096 characters, none of them a control character.
  [[nodiscard]] std::string text() const;
  [[nodiscard]] double number(double min, double max) const;
  [[nodiscard]] int integer(int min, int max) const;
  /// Written as true or false.
  [[nodiscard]] bool boolean() const;
  [[nodiscard]] std::vector<double> numbers(std::size_t count, double min, double max) const;
  /// Written as a number and ms, s, min or h.
  [[nodiscard]] std::chrono::nanoseconds duration(std::chrono::nanoseconds min, std::chrono::nanoseconds max) const;

  /// What stands here, with keys sorted, whatever its comments and layout: what a digest is taken of. Of a value that
  /// was read, and so is of bounded size.
  [[nodiscard]] std::string canonical() const;
  /// Every value below, `canonical`, by its key such as `pairs[0].drift.must_notice_deg`. A list of plain values is
  /// one.
  [[nodiscard]] std::map<std::string, std::string> values() const;

 private:
  ConfigNode(YAML::Node node, std::string key, int line);
  [[nodiscard]] std::string key_of(std::string_view child) const;
  [[nodiscard]] std::string plain_scalar(std::string_view needed) const;

  YAML::Node node_;
  std::string key_;  // e.g. pairs[0].camera.size; empty for the document
  int line_;
};

/// Hands `yaml`, said to be of `file`, to `read`. Fails with `bad_config` and one line
/// `FILE:LINE: pairs[0].camera.size: what is wrong; what to write` for the first thing that is: a text larger than
/// 1 MiB or that is not one YAML document, or what `read` refuses.
[[nodiscard]] Result<void> parse_config_text(std::string_view yaml, const std::filesystem::path& file,
                                             const std::function<void(const ConfigNode&)>& read);

/// The text of a regular file. Fails with `config_not_found`, or with `bad_config` when it is larger than 1 MiB.
[[nodiscard]] Result<std::string> read_config_text(const std::filesystem::path& file);

}  // namespace calib
