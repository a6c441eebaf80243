#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "uplink/calibd_request.hpp"
#include "uplink/file_sink.hpp"
#include "uplink/mqtt_sink.hpp"

namespace calib::uplink {

/// Fetches events from calibd, hands them to the sinks in their order, and tells calibd which all sinks have.
/// Nothing is kept: after any interruption it begins with the oldest event that calibd still has.
class Delivery {
 public:
  Delivery(const UplinkConfig& config, std::optional<FileSink> file, std::function<void()> wake);

  /// Does what can be done now, without waiting. To be called when a descriptor of `fds` can be read, when `wake` was
  /// called, and once a second.
  void step();
  [[nodiscard]] std::vector<int> fds() const;

  struct Figures {
    bool calibd_answers = false;
    std::uint64_t waiting = 0;  // events, in calibd
    std::uint64_t to_mqtt = 0, to_file = 0;
    std::int64_t acknowledged_at = 0;  // seconds since 1970, of the last one; 0 when there was none
    std::uint64_t file_failures = 0;
    std::optional<MqttSink::Figures> mqtt;
  };
  [[nodiscard]] Figures figures() const;

 private:
  using Clock = std::chrono::steady_clock;
  void fetch();
  void take(const nlohmann::json& reply);
  void write_file();
  void take_acknowledged();
  void publish();
  void acknowledge();
  void calibd_failed(const Error& error);

  const UplinkConfig& config_;
  std::function<void()> wake_;
  CalibdRequest feed_, acknowledgement_;
  std::optional<FileSink> file_;
  std::optional<MqttSink> mqtt_;  // from when the vehicle's name is known

  std::deque<MqttSink::Event> events_;                                // that calibd waits for, oldest first
  std::uint64_t fetched_ = 0;                                         // the last sequence
  std::uint64_t in_file_ = 0, in_broker_ = 0, in_mqtt_ = 0;           // all up to this sequence; `in_mqtt_`: settled
  std::deque<std::pair<std::uint64_t, Clock::time_point>> settling_;  // acknowledged by the broker, and when
  std::uint64_t published_ = 0;                                       // the last, on `connection_`
  std::uint64_t connection_ = 0;
  std::uint64_t acknowledged_ = 0, asked_ = 0;
  bool begin_anew_ = true;
  Clock::time_point next_fetch_, next_file_, next_acknowledgement_;
  std::string run_;  // of calibd, whose numbers these are
  std::string vehicle_;
  std::string failure_logged_, mqtt_failure_logged_;
  Figures figures_;
};

}  // namespace calib::uplink
