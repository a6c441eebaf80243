#include "dds/discovery.hpp"

#include <algorithm>
#include <memory>

#include "dds/bus.hpp"
#include "dds/names.hpp"
#include "support/catch.hpp"
#include "support/dds_peer.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

Bus& bus() {
  static Bus the_bus = require_ok(Bus::open(static_cast<std::uint32_t>(dds_domain()), "lo"));
  return the_bus;
}

/// What the bus knows of the writer on `topic`, once it knows of one.
RemoteWriter heard(const std::string& topic) {
  std::vector<RemoteWriter> found;
  REQUIRE(eventually([&] {
    found = require_ok(bus().remote_writers());
    std::erase_if(found, [&](const RemoteWriter& writer) { return writer.topic != topic; });
    return !found.empty();
  }));
  CHECK(found.size() == 1);
  return found.front();
}

using Qos = std::unique_ptr<dds_qos_t, decltype(&dds_delete_qos)>;

/// A cloud's writer whose QoS, and its publisher's, `spoil` has changed.
struct SpoiledWriter {
  template <typename Spoil>
  SpoiledWriter(const Peer& peer, const char* name, const Spoil& spoil) {
    const Qos qos(dds_create_qos(), &dds_delete_qos);
    spoil(qos.get());
    publisher = require_ok(own(dds_create_publisher(peer.participant(), qos.get(), nullptr), name));
    topic = require_ok(own(dds_create_topic(peer.participant(), cloud_type.descriptor, name, nullptr, nullptr), name));
    writer = require_ok(own(dds_create_writer(publisher.get(), topic.get(), qos.get(), nullptr), name));
  }
  Entity publisher, topic, writer;
};

}  // namespace

TEST_CASE("writers of other programs are listed with topic, type and reliability, own ones are not") {
  bus();
  const Peer peer(dds_domain());
  const auto cloud = require_ok(make_writer(peer.participant(), cloud_type, "/lidar/points", {}));
  const auto image = require_ok(make_writer(peer.participant(), image_type, "/front/image", {.reliable = true}));
  const auto raw = require_ok(make_writer(peer.participant(), image_type, "dds:Plain", {.reliable = true}));
  CHECK(heard("/lidar/points").type == "sensor_msgs/msg/PointCloud2");
  CHECK_FALSE(heard("/lidar/points").reliable);
  CHECK(heard("/front/image").type == "sensor_msgs/msg/Image");
  CHECK(heard("/front/image").reliable);
  CHECK(heard("/front/image").obstacle.empty());
  CHECK(heard("dds:Plain").type == "sensor_msgs/msg/Image");
  const auto all = require_ok(bus().remote_writers());
  CHECK(std::ranges::is_sorted(all, {}, &RemoteWriter::topic));
  CHECK(std::ranges::none_of(all, [](const RemoteWriter& writer) { return writer.topic == "/diagnostics"; }));
}

TEST_CASE("a writer that was deleted is not listed") {
  bus();
  const Peer peer(dds_domain());
  {
    const auto cloud = require_ok(make_writer(peer.participant(), cloud_type, "/gone", {}));
    CHECK(heard("/gone").topic == "/gone");
  }
  CHECK(eventually([] {
    const auto all = require_ok(bus().remote_writers());
    return std::ranges::none_of(all, [](const RemoteWriter& writer) { return writer.topic == "/gone"; });
  }));
}

TEST_CASE("the reason why a writer cannot be read is given") {
  bus();
  const Peer peer(dds_domain());
  const SpoiledWriter partition(peer, "rt/partition", [](dds_qos_t* qos) { dds_qset_partition1(qos, "night"); });
  const SpoiledWriter exclusive(peer, "rt/exclusive",
                                [](dds_qos_t* qos) { dds_qset_ownership(qos, DDS_OWNERSHIP_EXCLUSIVE); });
  const SpoiledWriter xcdr2(peer, "rt/xcdr2", [](dds_qos_t* qos) {
    const dds_data_representation_id_t id = DDS_DATA_REPRESENTATION_XCDR2;
    dds_qset_data_representation(qos, 1, &id);
  });
  const SpoiledWriter durable(peer, "rt/durable", [](dds_qos_t* qos) {
    dds_qset_durability(qos, DDS_DURABILITY_TRANSIENT_LOCAL);
    dds_qset_deadline(qos, DDS_SECS(1));
  });
  CHECK(heard("/partition").obstacle.find("'night'") != std::string::npos);
  CHECK(heard("/exclusive").obstacle.find("exclusive") != std::string::npos);
  CHECK(heard("/xcdr2").obstacle.find("XCDR2") != std::string::npos);
  CHECK(heard("/durable").obstacle.empty());
}
