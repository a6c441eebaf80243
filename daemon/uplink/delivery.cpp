#include "uplink/delivery.hpp"

#include <algorithm>
#include <ctime>

#include "calib/json_integer.hpp"
#include "uplink/log.hpp"

namespace calib::uplink {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;

/// As many events are held here, of 2 kB each.
constexpr std::size_t most_events = 300;
constexpr std::size_t fetched_at_once = 100;
constexpr auto between_failures = 1s, between_acknowledgements = 10s;
/// calibd holds a reply for 30 s, and an acknowledgement for as long as a step of it takes.
constexpr auto longest_reply = 60s, longest_acknowledgement = 600s;

}  // namespace

Delivery::Delivery(const UplinkConfig& config, std::optional<FileSink> file, std::function<void()> wake)
    : config_(config),
      wake_(std::move(wake)),
      feed_(config.socket),
      acknowledgement_(config.socket),
      file_(std::move(file)) {}

std::vector<int> Delivery::fds() const { return {feed_.fd(), acknowledgement_.fd()}; }

void Delivery::step() {
  fetch();
  write_file();
  publish();
  acknowledge();
}

void Delivery::calibd_failed(const Error& error) {
  figures_.calibd_answers = false;
  // What it says next may be of another store.
  begin_anew_ = true;
  feed_.cancel();  // it may ask for what follows events that are forgotten now
  acknowledgement_.cancel();
  next_fetch_ = Clock::now() + between_failures;
  if (mqtt_) mqtt_->say_calibd_answers(false);
  if (std::exchange(failure_logged_, error.context) != error.context)
    log(4, error.context + "; it is tried again every second");
}

/// One request waits for the next event all the time, unless there is no room.
void Delivery::fetch() {
  if (feed_.is_waiting())
    if (const auto reply = feed_.receive()) {
      next_fetch_ = Clock::now();
      if (*reply)
        take(**reply);
      else
        calibd_failed(reply->error());
    }
  if (feed_.is_waiting() || events_.size() + fetched_at_once > most_events || Clock::now() < next_fetch_) return;
  const std::uint64_t after = begin_anew_ ? 0 : fetched_;
  const auto sent = feed_.send({{"schema", 1},
                                {"request", "feed"},
                                {"after", after},
                                {"limit", fetched_at_once},
                                // The first answer tells the vehicle's name, and that calibd answers.
                                {"wait", !begin_anew_}},
                               longest_reply);
  if (!sent) calibd_failed(sent.error());
}

void Delivery::take(const json& reply) try {
  const std::string vehicle = reply.at("vehicle").get<std::string>();
  if (!begin_anew_ && !vehicle.empty() && reply.at("run") != run_)
    return calibd_failed({ErrorCode::failed, "calibd was started again"});
  if (begin_anew_) {
    // Topics, will and name of the connection are those of the vehicle.
    if (mqtt_ && !vehicle.empty() && vehicle != vehicle_) mqtt_.reset(), connection_ = 0;
    if (!vehicle.empty()) vehicle_ = vehicle;
    log(6, "calibd of vehicle " + vehicle + " answers, " + reply.at("waiting").dump() + " events wait");
    events_.clear();
    fetched_ = in_file_ = in_broker_ = in_mqtt_ = published_ = acknowledged_ = asked_ = 0;
    settling_.clear();
    if (mqtt_) mqtt_->forget();
    failure_logged_.clear();
    begin_anew_ = false;
  }
  if (!vehicle.empty() && config_.mqtt && !mqtt_) mqtt_.emplace(*config_.mqtt, vehicle, wake_);
  if (mqtt_) mqtt_->say_calibd_answers(true);
  figures_.calibd_answers = true;
  if (!vehicle.empty()) run_ = reply.at("run").get<std::string>();
  if (!vehicle.empty()) figures_.waiting = integer_from<std::uint64_t>(reply.at("waiting"));
  for (const json& event : reply.at("events")) {
    events_.push_back({integer_from<std::uint64_t>(event.at("sequence")), event.at("priority") == "state",
                       event.at("event").get<std::string>()});
    fetched_ = events_.back().sequence;
  }
  // calibd holds an empty reply for a while, unless too many wait already.
  if (reply.at("events").empty()) next_fetch_ = Clock::now() + 200ms;
} catch (const std::exception& exception) {
  calibd_failed({ErrorCode::malformed_reply, std::string("calibd's answer is not understood: ") + exception.what()});
}

void Delivery::write_file() {
  if (!file_ || in_file_ >= fetched_ || Clock::now() < next_file_) return;
  std::uint64_t last = in_file_, count = 0;
  Result<void> written;
  for (const MqttSink::Event& event : events_) {
    if (event.sequence <= in_file_) continue;
    written = file_->append(event.text);
    if (!written) break;
    last = event.sequence;
    ++count;
  }
  if (count > 0)
    if (auto synced = file_->sync(); !synced) written = synced;
  if (!written) {
    log(4, written.error().context + "; it is tried again in ten seconds, and nothing is lost meanwhile");
    ++figures_.file_failures;
    next_file_ = Clock::now() + 10s;
    return;
  }
  in_file_ = last;
  figures_.to_file += count;
}

/// What a broker has acknowledged it may still lose: when it is killed before it has written that to its disk. It
/// counts after a while, and if the connection has lasted. After another connection the rest is fetched and sent once
/// more.
void Delivery::take_acknowledged() {
  const auto connection = mqtt_->connection();
  const bool is_another = std::exchange(connection_, connection) != connection;
  if (is_another && published_ > in_mqtt_) {
    feed_.cancel();
    events_.clear();
    settling_.clear();
    mqtt_->forget();
    fetched_ = published_ = in_broker_ = in_mqtt_;
  }
  if (is_another && connection != 0) {
    log(6, "connected to the broker at " + config_.mqtt->host);
    mqtt_failure_logged_.clear();
  }
  for (const std::uint64_t sequence : mqtt_->take_acknowledged()) {
    // A broker acknowledges in the order in which it received them.
    in_broker_ = std::max(in_broker_, std::min(sequence, published_));
    settling_.emplace_back(in_broker_, Clock::now());
    ++figures_.to_mqtt;
  }
  for (; !settling_.empty() && Clock::now() - settling_.front().second >= config_.mqtt->settle; settling_.pop_front())
    in_mqtt_ = settling_.front().first;
}

void Delivery::publish() {
  if (!mqtt_) return;
  take_acknowledged();
  if (const auto figures = mqtt_->figures();
      !figures.connected && !figures.last_failure.empty() &&
      std::exchange(mqtt_failure_logged_, figures.last_failure) != figures.last_failure)
    log(4, "no connection to the broker at " + config_.mqtt->host + ": " + figures.last_failure +
               "; events wait in calibd's store");
  if (connection_ == 0) return;
  for (const MqttSink::Event& event : events_) {
    if (event.sequence <= published_) continue;
    if (!mqtt_->publish(connection_, event)) break;
    published_ = event.sequence;
  }
}

void Delivery::acknowledge() {
  if (acknowledgement_.is_waiting())
    if (const auto reply = acknowledgement_.receive()) {
      if (*reply) {
        acknowledged_ = std::max(acknowledged_, asked_);
        figures_.waiting = (*reply)->value("waiting", figures_.waiting);
        figures_.acknowledged_at = std::time(nullptr);
      } else if (const Error& error = reply->error();
                 error.code == ErrorCode::failed || error.code == ErrorCode::denied) {
        // calibd is there, and so are its events: only this is asked again.
        next_acknowledgement_ = Clock::now() + between_acknowledgements;
        if (std::exchange(failure_logged_, error.context) != error.context) log(4, error.context);
      } else {
        calibd_failed(error);
      }
    }
  const auto all_have = [&](std::uint64_t sequence) {
    return (!file_ || sequence <= in_file_) && (!config_.mqtt || sequence <= in_broker_);
  };
  while (!events_.empty() && all_have(events_.front().sequence)) events_.pop_front();
  std::uint64_t received = fetched_;
  if (file_) received = std::min(received, in_file_);
  if (config_.mqtt) received = std::min(received, in_mqtt_);
  if (received <= acknowledged_ || acknowledgement_.is_waiting() || begin_anew_ || Clock::now() < next_acknowledgement_)
    return;
  asked_ = received;
  const auto sent = acknowledgement_.send(
      {{"schema", 1}, {"request", "acknowledge"}, {"through", asked_}, {"run", run_}}, longest_acknowledgement);
  if (!sent) calibd_failed(sent.error());
}

Delivery::Figures Delivery::figures() const {
  Figures figures = figures_;
  if (mqtt_) figures.mqtt = mqtt_->figures();
  return figures;
}

}  // namespace calib::uplink
