#include "uplink/uplink_config.hpp"

#include <algorithm>

#include "calib/config_node.hpp"

namespace calib::uplink {
namespace {

using namespace std::chrono_literals;

std::filesystem::path absolute_path(const ConfigNode& node) {
  const std::filesystem::path path = node.text();
  if (!path.is_absolute() || !path.has_filename()) node.refuse("needs the absolute path of a file");
  return path;
}

std::chrono::milliseconds milliseconds(const ConfigNode& node, std::chrono::milliseconds min,
                                       std::chrono::milliseconds max) {
  return std::chrono::duration_cast<std::chrono::milliseconds>(node.duration(min, max));
}

bool is_this_machine(const std::string& host) {
  return host == "localhost" || host == "::1" || host.starts_with("127.");
}

MqttVersion read_version(const ConfigNode& node) {
  const std::string version = node.text();
  if (version == "auto") return MqttVersion::automatic;
  if (version == "5") return MqttVersion::v5;
  if (version != "3.1.1") node.refuse("is none of: auto, 5, 3.1.1");
  return MqttVersion::v3_1_1;
}

std::string read_host(const ConfigNode& node) {
  const std::string host = node.text();
  const auto is_allowed = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '-' ||
           c == ':';
  };
  if (host.size() > 253 || !std::ranges::all_of(host, is_allowed)) node.refuse("needs a host name or an address");
  return host;
}

std::optional<TlsConfig> read_tls(const ConfigNode& mqtt, const std::string& host) {
  if (is_this_machine(host) && !mqtt.find("tls")) return std::nullopt;
  const ConfigNode node = mqtt.at("tls");
  node.with_keys({"ca", "certificate", "key"});
  return TlsConfig{absolute_path(node.at("ca")), absolute_path(node.at("certificate")), absolute_path(node.at("key"))};
}

MqttConfig read_mqtt(const ConfigNode& node) {
  node.with_keys({"host", "port", "version", "keep_alive", "tls", "settle", "first_delay", "longest_delay"});
  MqttConfig mqtt{.host = read_host(node.at("host")), .tls = {}};
  mqtt.tls = read_tls(node, mqtt.host);
  mqtt.port = mqtt.tls ? 8883 : 1883;
  if (const auto port = node.find("port")) mqtt.port = port->integer(1, 65535);
  if (const auto version = node.find("version")) mqtt.version = read_version(*version);
  if (const auto time = node.find("keep_alive"))
    mqtt.keep_alive = std::chrono::duration_cast<std::chrono::seconds>(time->duration(5s, 20min));
  if (const auto time = node.find("settle")) mqtt.settle = milliseconds(*time, 0ms, 1h);
  if (const auto delay = node.find("first_delay")) mqtt.first_delay = milliseconds(*delay, 10ms, 1min);
  if (const auto delay = node.find("longest_delay")) mqtt.longest_delay = milliseconds(*delay, mqtt.first_delay, 1h);
  mqtt.longest_delay = std::max(mqtt.longest_delay, mqtt.first_delay);
  return mqtt;
}

FileConfig read_file(const ConfigNode& node) {
  node.with_keys({"path", "max_size_mb", "keep"});
  FileConfig file{.path = absolute_path(node.at("path"))};
  if (const auto size = node.find("max_size_mb"))
    file.max_bytes = static_cast<std::uint64_t>(size->number(0.01, 1000) * 1e6);
  if (const auto keep = node.find("keep")) file.keep = keep->integer(1, 100);
  return file;
}

MetricsConfig read_metrics(const ConfigNode& node) {
  node.with_keys({"path", "period"});
  MetricsConfig metrics{.path = absolute_path(node.at("path"))};
  if (metrics.path.extension() != ".prom") node.at("path").refuse("must end in .prom, or node_exporter ignores it");
  if (const auto period = node.find("period")) metrics.period = milliseconds(*period, 1s, 1h);
  return metrics;
}

UplinkConfig read_config(const ConfigNode& top) {
  top.with_keys({"socket", "mqtt", "file", "metrics"});
  UplinkConfig config;
  if (const auto socket = top.find("socket")) config.socket = absolute_path(*socket);
  if (const auto mqtt = top.find("mqtt")) config.mqtt = read_mqtt(*mqtt);
  if (const auto file = top.find("file")) config.file = read_file(*file);
  if (const auto metrics = top.find("metrics")) config.metrics = read_metrics(*metrics);
  if (!config.mqtt && !config.file) top.refuse("needs mqtt or file, or both: where events shall go");
  return config;
}

}  // namespace

Result<UplinkConfig> parse_uplink_config(std::string_view yaml, const std::filesystem::path& file) {
  UplinkConfig config;
  const auto read = parse_config_text(yaml, file, [&](const ConfigNode& top) { config = read_config(top); });
  if (!read) return propagate(read);
  return config;
}

Result<UplinkConfig> load_uplink_config(const std::filesystem::path& file) {
  const auto yaml = read_config_text(file);
  if (!yaml) return propagate(yaml);
  return parse_uplink_config(*yaml, file);
}

}  // namespace calib::uplink
