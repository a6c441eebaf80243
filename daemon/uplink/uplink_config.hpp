#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <optional>
#include <string>
#include <string_view>

#include "calib/result.hpp"

namespace calib::uplink {

// /etc/calibd/uplink.yaml as values. systemd/uplink.yaml explains every key, its unit and its default.

struct TlsConfig {
  std::filesystem::path ca, certificate, key;
};

enum class MqttVersion { automatic, v5, v3_1_1 };

struct MqttConfig {
  std::string host;
  int port = 8883;
  MqttVersion version = MqttVersion::automatic;
  std::chrono::seconds keep_alive{60};
  std::optional<TlsConfig> tls;  // none: to this machine only
  /// So long after a broker has acknowledged an event, and if the connection has lasted, it will not lose it any more.
  std::chrono::milliseconds settle{5'000};
  /// Between two attempts to connect: doubled from the first to the longest, each less a random part of up to a half.
  std::chrono::milliseconds first_delay{1'000}, longest_delay{300'000};
};

struct FileConfig {
  std::filesystem::path path;
  std::uint64_t max_bytes = 10'000'000;
  int keep = 5;  // files beside the one that is written
};

struct MetricsConfig {
  std::filesystem::path path;
  std::chrono::milliseconds period{15'000};
};

struct UplinkConfig {
  std::filesystem::path socket = "/run/calibd/control.sock";
  std::optional<MqttConfig> mqtt;
  std::optional<FileConfig> file;
  std::optional<MetricsConfig> metrics;
};

/// Fails with `bad_config` and one line `FILE:LINE: mqtt.port: what is wrong` for the first error.
[[nodiscard]] Result<UplinkConfig> parse_uplink_config(std::string_view yaml, const std::filesystem::path& file);
/// Fails also with `config_not_found`.
[[nodiscard]] Result<UplinkConfig> load_uplink_config(const std::filesystem::path& file);

}  // namespace calib::uplink
