#include <dds/ddsi/ddsi_serdata.h>

#include <cstdio>
#include <nlohmann/json.hpp>

#include "dds/bus.hpp"
#include "support/dds_peer.hpp"
#include "support/ros_messages.hpp"

/// Prints what calibd's writers put on the wire, received by a peer over loopback: one JSON object per
/// message with its topic, type, user data and CDR (hexadecimal). cdr_test.py knows the values and compares
/// with another implementation.

namespace {

using namespace calib;
using namespace calib::test;
using namespace std::chrono_literals;

/// The bytes of the next sample, with the encapsulation header. A reader may know a writer that does not yet
/// know it, so `publish` is repeated.
std::vector<unsigned char> next_cdr(const Endpoint& reader, const std::function<void()>& publish) {
  ddsi_serdata* sample = nullptr;
  dds_sample_info_t info;
  const bool received = eventually([&] {
    publish();
    return dds_takecdr(reader.endpoint.get(), &sample, 1, &info, DDS_ANY_STATE) == 1;
  });
  if (!received) throw std::runtime_error("nothing arrived");
  std::vector<unsigned char> bytes(ddsi_serdata_size(sample));
  ddsi_serdata_to_ser(sample, 0, bytes.size(), bytes.data());
  ddsi_serdata_unref(sample);
  return bytes;
}

std::string user_data(const Endpoint& reader) {
  dds_instance_handle_t writer = 0;
  if (!eventually([&] { return dds_get_matched_publications(reader.endpoint.get(), &writer, 1) == 1; }))
    throw std::runtime_error("no writer");
  dds_builtintopic_endpoint_t* endpoint = dds_get_matched_publication_data(reader.endpoint.get(), writer);
  void* bytes = nullptr;
  std::size_t size = 0;
  dds_qget_userdata(endpoint->qos, &bytes, &size);
  std::string text(static_cast<char*>(bytes), size);
  dds_free(bytes);
  dds_builtintopic_free_endpoint(endpoint);
  return text;
}

void dump(const Peer& peer, const MessageType& type, const std::string& topic, const std::function<void()>& publish) {
  const Endpoint reader = require_ok(make_reader(peer.participant(), type, topic, {.reliable = true}));
  std::string hex;
  const std::string hash = user_data(reader);
  for (const unsigned char byte : next_cdr(reader, publish)) {
    constexpr char digits[] = "0123456789abcdef";
    hex += {digits[byte >> 4], digits[byte & 15]};
  }
  const nlohmann::json line{{"topic", topic}, {"type", type.descriptor->m_typename}, {"user_data", hash}, {"cdr", hex}};
  std::puts(line.dump().c_str());
}

/// A message of the kinds that calibd reads, written as calibd's endpoints would.
template <typename Message>
void dump_input(const Peer& peer, dds_entity_t participant, const MessageType& type, const std::string& topic,
                Message message) {
  const Endpoint writer = require_ok(make_writer(participant, type, topic, {.reliable = true}));
  dump(peer, type, topic, [&] {
    const auto raw = message.raw();
    require_ok(check(dds_write(writer.endpoint.get(), &raw), "write"));
  });
}

Status known_status() {
  Status status;
  status.vehicle = "demo-car";
  PairStatus& pair = status.pairs.emplace_back();
  pair.name = "front";
  pair.verdict = Verdict::suspect;
  pair.reason = "yaw has moved";
  pair.evaluated = 12;
  pair.skipped["low_overlap"] = 3;
  pair.image.topic = "/left/image";
  pair.cloud.topic = "/points";
  return status;
}

void dump_all() {
  Bus bus = require_ok(Bus::open(static_cast<std::uint32_t>(dds_domain()), "lo"));
  const Peer peer(dds_domain());
  const Entity other = require_ok(
      own(dds_create_participant(static_cast<dds_domainid_t>(dds_domain()), nullptr, nullptr), "participant"));

  dump(peer, diagnostics_type, "/diagnostics",
       [&] { require_ok(bus.publish_diagnostics(known_status(), 1'700'000'000s + 5ns)); });
  ProposedExtrinsic proposed{"camera", "lidar", RigidTransform::Identity()};
  proposed.T_camera_lidar.translation() = Eigen::Vector3d(0.1, -0.2, 0.3);
  dump(peer, transforms_type, "/calibd/tf_static_proposed", [&] {
    require_ok(bus.publish_proposed(std::vector{proposed, proposed}, 7s));
  });
  DriftAlert alert{.stamp = 7s + 9ns,
                   .alert_sequence = 5,
                   .vehicle = "demo-car",
                   .pair = "front",
                   .verdict = Verdict::drifted,
                   .previous_verdict = Verdict::calibrated,
                   .reason = "yaw",
                   .misalignment = {},
                   .record_sequence = 4};
  alert.misalignment.delta << 0.1, 0.2, 0.3, 0.4, 0.5, 0.6;
  alert.misalignment.sigma << 1, 2, 3, 4, 5, 6;
  dump(peer, drift_alert_type, "/calibd/drift_alert", [&] { require_ok(bus.publish_alert(alert)); });

  dump_input(peer, other.get(), image_type, "/image", ImageMessage{});
  CompressedImageMessage compressed;
  compressed.data = {1, 2, 3};
  dump_input(peer, other.get(), compressed_image_type, "/image/compressed", compressed);
  dump_input(peer, other.get(), camera_info_type, "/camera_info", CameraInfoMessage{});
  dump_input(peer, other.get(), cloud_type, "/points", CloudMessage{});
  dump_input(peer, other.get(), disparity_image_type, "/disparity", DisparityMessage{});
  dump_input(peer, other.get(), imu_type, "/imu", ImuMessage{});
  dump_input(peer, other.get(), odometry_type, "/odometry", OdometryMessage{});
}

}  // namespace

int main() {
  try {
    dump_all();
  } catch (const std::exception& e) {
    std::fprintf(stderr, "wire_dump: %s\n", e.what());
    return 1;
  }
}
