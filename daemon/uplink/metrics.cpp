#include "uplink/metrics.hpp"

namespace calib::uplink {
namespace {

void metric(std::string& text, const std::string& name, const char* type, const char* help, std::uint64_t value) {
  const std::string full = "calib_uplink_" + name;
  text += "# HELP " + full + ' ' + help + "\n# TYPE " + full + ' ' + type + '\n' + full + ' ' + std::to_string(value) +
          '\n';
}

}  // namespace

std::string metrics_text(const Delivery::Figures& figures) {
  std::string text;
  metric(text, "calibd_answers", "gauge", "Whether calibd answers.", figures.calibd_answers);
  metric(text, "events_waiting", "gauge", "Events in calibd's outbox.", figures.waiting);
  metric(text, "last_acknowledged_timestamp_seconds", "gauge", "When an event last left the outbox; 0: none did.",
         static_cast<std::uint64_t>(figures.acknowledged_at));
  metric(text, "file_events_total", "counter", "Events written to the file.", figures.to_file);
  metric(text, "file_failures_total", "counter", "Writes to the file that failed.", figures.file_failures);
  if (!figures.mqtt) return text;
  metric(text, "mqtt_connected", "gauge", "Whether there is a connection to the broker.", figures.mqtt->connected);
  metric(text, "mqtt_events_total", "counter", "Events that the broker acknowledged.", figures.to_mqtt);
  metric(text, "mqtt_connections_total", "counter", "Connections to the broker.", figures.mqtt->connections);
  metric(text, "mqtt_failures_total", "counter", "Connections that failed or ended.", figures.mqtt->failures);
  metric(text, "mqtt_refused_total", "counter", "Events that the broker refused.", figures.mqtt->refused);
  return text;
}

}  // namespace calib::uplink
