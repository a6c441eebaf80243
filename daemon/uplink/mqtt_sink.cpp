#include "uplink/mqtt_sink.hpp"

#include <mosquitto.h>
#include <mqtt_protocol.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <memory>

namespace calib::uplink {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

/// A broker that has not answered for so long is given up.
constexpr auto longest_handshake = 20s;
/// A connection that lasted so long was a good one, though nothing had to be sent.
constexpr auto proven_after = 60s;

std::string in_words(int code) { return code == MOSQ_ERR_ERRNO ? std::strerror(errno) : mosquitto_strerror(code); }

}  // namespace

std::chrono::milliseconds Backoff::next() {
  const std::chrono::milliseconds doubled = first_ * (1LL << std::min(failures_++, 20));
  const auto delay = std::min(longest_, doubled);
  return std::chrono::milliseconds(
      std::uniform_int_distribution<std::int64_t>(delay.count() / 2, delay.count())(random_));
}

struct MqttSink::Callbacks {
  static void on_connect(mosquitto*, void* sink, int reason, int, const mosquitto_property*) {
    static_cast<MqttSink*>(sink)->connected(reason);
  }
  static void on_publish(mosquitto*, void* sink, int message, int reason, const mosquitto_property*) {
    static_cast<MqttSink*>(sink)->published(message, reason);
  }
};

MqttSink::MqttSink(MqttConfig config, std::string vehicle, std::function<void()> wake)
    : config_(std::move(config)),
      vehicle_(std::move(vehicle)),
      wake_(std::move(wake)),
      uses_v5_(config_.version != MqttVersion::v3_1_1) {
  mosquitto_lib_init();
  thread_ = std::thread([this] { run(); });
}

MqttSink::~MqttSink() {
  {
    const std::lock_guard lock(mutex_);
    stopping_ = true;
    if (client_ != nullptr) publish_online("offline");
  }
  stop_.notify_all();
  thread_.join();
  mosquitto_lib_cleanup();
}

void MqttSink::run() {
  Backoff backoff(config_.first_delay, config_.longest_delay);
  std::unique_lock lock(mutex_);
  while (!stopping_) {
    is_proven_ = false;
    lock.unlock();
    std::string failure = connect_once();
    lock.lock();
    if (is_proven_) backoff.reset();
    if (stopping_) break;
    ++figures_.failures;
    figures_.last_failure = std::move(failure);
    wake_();
    stop_.wait_for(lock, backoff.next(), [this] { return stopping_; });
  }
}

std::string MqttSink::set_up(mosquitto* client) {
  mosquitto_connect_v5_callback_set(client, Callbacks::on_connect);
  mosquitto_publish_v5_callback_set(client, Callbacks::on_publish);
  mosquitto_int_option(client, MOSQ_OPT_PROTOCOL_VERSION, uses_v5_ ? MQTT_PROTOCOL_V5 : MQTT_PROTOCOL_V311);
  mosquitto_int_option(client, MOSQ_OPT_SEND_MAXIMUM, static_cast<int>(most_in_flight) + 4);
  mosquitto_threaded_set(client, true);  // `publish` wakes the loop
  constexpr std::string_view offline = "offline";
  int code =
      mosquitto_will_set(client, topic("online").c_str(), static_cast<int>(offline.size()), offline.data(), 1, true);
  if (code == MOSQ_ERR_SUCCESS && config_.tls) {
    code = mosquitto_tls_set(client, config_.tls->ca.c_str(), nullptr, config_.tls->certificate.c_str(),
                             config_.tls->key.c_str(), nullptr);
    if (code == MOSQ_ERR_INVAL) return "a file of mqtt.tls cannot be read";
    if (code == MOSQ_ERR_SUCCESS) code = mosquitto_tls_opts_set(client, 1, "tlsv1.3", nullptr);
  }
  return code == MOSQ_ERR_SUCCESS ? "" : in_words(code);
}

/// From connecting to the connection's end; returns why it ended.
std::string MqttSink::connect_once() {
  const std::string id = "calibd-" + vehicle_;
  const std::unique_ptr<mosquitto, void (*)(mosquitto*)> client(mosquitto_new(id.c_str(), true, this),
                                                                mosquitto_destroy);
  if (!client) return "no memory";
  if (std::string failure = set_up(client.get()); !failure.empty()) return failure;
  int code =
      mosquitto_connect(client.get(), config_.host.c_str(), config_.port, static_cast<int>(config_.keep_alive.count()));
  if (code != MOSQ_ERR_SUCCESS) return in_words(code);

  {
    const std::lock_guard lock(mutex_);
    client_ = client.get();
    refusal_.clear();
  }
  const auto begun = Clock::now();
  auto end = Clock::time_point::max();
  std::string failure;
  while (failure.empty()) {
    code = mosquitto_loop(client.get(), 1000, 1);
    const std::lock_guard lock(mutex_);
    if (code != MOSQ_ERR_SUCCESS)
      failure = in_words(code);
    else if (!refusal_.empty())
      failure = refusal_;
    else if (connection_ == 0 && Clock::now() - begun > longest_handshake)
      failure = "the broker does not answer";
    if (!refusal_.empty()) failure = refusal_;
    if (connection_ != 0 && Clock::now() - begun > proven_after) is_proven_ = true;
    if (!stopping_) continue;
    end = std::min(end, Clock::now() + 2s);
    if (in_flight_.empty() || connection_ == 0 || Clock::now() > end) break;
  }
  // libmosquitto calls back when it leaves, and locks nothing of ours then.
  mosquitto_disconnect(client.get());
  const std::lock_guard lock(mutex_);
  if (!refusal_.empty()) is_proven_ = false;  // what it took before is no reason to come back at once
  // A broker that knows no MQTT 5 refuses it, or closes the connection without a word.
  if (connection_ == 0 && config_.version == MqttVersion::automatic) uses_v5_ = !uses_v5_;
  client_ = nullptr;
  connection_ = 0;
  in_flight_.clear();
  figures_.connected = false;
  return failure;
}

void MqttSink::connected(int reason) {
  const std::lock_guard lock(mutex_);
  if (reason != 0) {
    refusal_ = std::string("the broker refuses: ") +
               (uses_v5_ ? mosquitto_reason_string(reason) : mosquitto_connack_string(reason));
    return;
  }
  connection_ = ++figures_.connections;
  figures_.connected = true;
  figures_.last_failure.clear();
  publish_online(calibd_answers_ ? "online" : "calibd_silent");
  wake_();
}

void MqttSink::published(int message, int reason) {
  const std::lock_guard lock(mutex_);
  const auto found = in_flight_.find(message);
  if (found == in_flight_.end()) return;
  const std::uint64_t sequence = found->second;
  in_flight_.erase(found);
  if (reason >= 0x80) {
    ++figures_.refused;
    refusal_ = std::string("the broker refuses an event: ") + mosquitto_reason_string(reason);
    return;
  }
  if (sequence == 0) return;
  is_proven_ = true;
  acknowledged_.push_back(sequence);
  wake_();
}

/// With the lock held.
void MqttSink::publish_online(const char* word) {
  int message = 0;
  if (mosquitto_publish(client_, &message, topic("online").c_str(), static_cast<int>(std::strlen(word)), word, 1,
                        true) == MOSQ_ERR_SUCCESS)
    in_flight_[message] = 0;
}

bool MqttSink::publish(std::uint64_t connection, const Event& event) {
  const std::lock_guard lock(mutex_);
  if (connection_ == 0 || connection_ != connection || stopping_ || in_flight_.size() >= most_in_flight) return false;
  mosquitto_property* properties = nullptr;
  if (uses_v5_) mosquitto_property_add_string(&properties, MQTT_PROP_CONTENT_TYPE, "application/cloudevents+json");
  int message = 0;
  const int code =
      mosquitto_publish_v5(client_, &message, topic(event.is_state ? "state" : "alert").c_str(),
                           static_cast<int>(event.text.size()), event.text.data(), 1, event.is_state, properties);
  mosquitto_property_free_all(&properties);
  if (code != MOSQ_ERR_SUCCESS) return false;
  in_flight_[message] = event.sequence;
  return true;
}

std::uint64_t MqttSink::connection() const {
  const std::lock_guard lock(mutex_);
  return connection_;
}

std::vector<std::uint64_t> MqttSink::take_acknowledged() {
  const std::lock_guard lock(mutex_);
  return std::exchange(acknowledged_, {});
}

void MqttSink::forget() {
  const std::lock_guard lock(mutex_);
  acknowledged_.clear();
  for (auto& [message, sequence] : in_flight_) sequence = 0;
}

void MqttSink::say_calibd_answers(bool answers) {
  const std::lock_guard lock(mutex_);
  if (std::exchange(calibd_answers_, answers) == answers || connection_ == 0) return;
  publish_online(answers ? "online" : "calibd_silent");
}

MqttSink::Figures MqttSink::figures() const {
  const std::lock_guard lock(mutex_);
  return figures_;
}

}  // namespace calib::uplink
