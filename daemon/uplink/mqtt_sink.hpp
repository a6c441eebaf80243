#pragma once

#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <mutex>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "uplink/uplink_config.hpp"

struct mosquitto;

namespace calib::uplink {

/// How long to wait before the next attempt to connect: doubled with each failure up to the longest, less a random part
/// of up to a half, so that the vehicles of a fleet do not come back all at once.
class Backoff {
 public:
  Backoff(std::chrono::milliseconds first, std::chrono::milliseconds longest) : first_(first), longest_(longest) {}
  [[nodiscard]] std::chrono::milliseconds next();
  void reset() { failures_ = 0; }

 private:
  std::chrono::milliseconds first_, longest_;
  int failures_ = 0;
  std::mt19937 random_{std::random_device{}()};
};

/// A connection to a broker, on a thread of its own: libmosquitto waits when it connects. Each attempt begins with a
/// new client, and what was not acknowledged by then is forgotten: whoever publishes begins anew with each
/// `connection`. Calls are for one other thread.
class MqttSink {
 public:
  /// `wake` is called, from the other thread, whenever a call here would return something else than before.
  MqttSink(MqttConfig config, std::string vehicle, std::function<void()> wake);
  /// Says `offline` and leaves, within two seconds if the broker answers.
  ~MqttSink();
  MqttSink(const MqttSink&) = delete;
  MqttSink& operator=(const MqttSink&) = delete;

  struct Event {
    std::uint64_t sequence = 0;
    bool is_state = false;
    std::string text;
  };
  /// The number of the present connection, 0 while there is none.
  [[nodiscard]] std::uint64_t connection() const;
  /// On the connection of that number, so that the order is kept. False: it has ended, or `most_in_flight` wait to be
  /// acknowledged.
  [[nodiscard]] bool publish(std::uint64_t connection, const Event& event);
  /// Sequences of events that the broker has acknowledged since the last call.
  [[nodiscard]] std::vector<std::uint64_t> take_acknowledged();
  /// Acknowledgements of what was published so far are of no interest any more.
  void forget();
  /// Published, and again with each connection: whether calibd answers.
  void say_calibd_answers(bool answers);

  struct Figures {
    bool connected = false;
    std::uint64_t connections = 0, failures = 0, refused = 0;
    std::string last_failure;  // in words; empty while connected
  };
  [[nodiscard]] Figures figures() const;

  static constexpr std::size_t most_in_flight = 64;

 private:
  struct Callbacks;
  void run();
  [[nodiscard]] std::string connect_once();
  [[nodiscard]] std::string set_up(mosquitto* client);
  void publish_online(const char* word);
  void connected(int reason);
  void published(int message, int reason);
  [[nodiscard]] std::string topic(const char* name) const { return "fleet/v1/" + vehicle_ + "/calib/" + name; }

  MqttConfig config_;
  std::string vehicle_;
  std::function<void()> wake_;
  bool uses_v5_;

  mutable std::mutex mutex_;  // guards what is below
  std::condition_variable stop_;
  bool stopping_ = false;
  mosquitto* client_ = nullptr;  // while there is a connection
  std::uint64_t connection_ = 0;
  std::map<int, std::uint64_t> in_flight_;  // by libmosquitto's number: the sequence, 0 for `online`
  std::vector<std::uint64_t> acknowledged_;
  std::string refusal_;  // by the broker: ends the connection
  bool calibd_answers_ = true, is_proven_ = false;
  Figures figures_;

  std::thread thread_;
};

}  // namespace calib::uplink
