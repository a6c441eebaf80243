#include "dds/entity.hpp"

#include <memory>
#include <string>

#include "dds/names.hpp"

namespace calib {
namespace {

struct DeleteQos {
  void operator()(dds_qos_t* qos) const { dds_delete_qos(qos); }
};
using Qos = std::unique_ptr<dds_qos_t, DeleteQos>;

Qos make_qos(const MessageType& type, const QosProfile& profile) {
  Qos qos(dds_create_qos());
  dds_qset_reliability(qos.get(), profile.reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                       DDS_MSECS(100));
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, profile.depth);
  dds_qset_durability(qos.get(), profile.durable ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
  if (profile.durable)  // late readers get this history, not that of the writer
    dds_qset_durability_service(qos.get(), 0, DDS_HISTORY_KEEP_LAST, profile.depth, DDS_LENGTH_UNLIMITED,
                                DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  const dds_data_representation_id_t xcdr1 = DDS_DATA_REPRESENTATION_XCDR1;
  dds_qset_data_representation(qos.get(), 1, &xcdr1);
  const std::string typehash = "typehash=RIHS01_" + std::string(type.rihs01) + ";";
  dds_qset_userdata(qos.get(), typehash.data(), typehash.size());
  return qos;
}

using Create = dds_entity_t (*)(dds_entity_t, dds_entity_t, const dds_qos_t*, const dds_listener_t*);

Result<Endpoint> make_endpoint(Create create, dds_entity_t participant, const MessageType& type,
                               std::string_view topic_name, const QosProfile& profile) {
  const auto name = dds_topic_name(topic_name);
  if (!name) return propagate(name);
  auto topic = own(dds_create_topic(participant, type.descriptor, name->c_str(), nullptr, nullptr), *name);
  if (!topic) return propagate(topic);
  const Qos qos = make_qos(type, profile);
  auto endpoint = own(create(participant, topic->get(), qos.get(), nullptr), *name);
  if (!endpoint) return propagate(endpoint);
  return Endpoint{std::move(*topic), std::move(*endpoint)};
}

}  // namespace

Result<void> check(dds_return_t returned, std::string_view what) {
  if (returned < 0) return fail(ErrorCode::dds_failed, std::string(what) + ": " + dds_strretcode(returned));
  return {};
}

Result<Entity> own(dds_entity_t returned, std::string_view what) {
  if (const auto made = check(returned, what); !made) return propagate(made);
  return Entity(returned);
}

Result<Endpoint> make_reader(dds_entity_t participant, const MessageType& type, std::string_view topic,
                             const QosProfile& profile) {
  return make_endpoint(&dds_create_reader, participant, type, topic, profile);
}

Result<Endpoint> make_writer(dds_entity_t participant, const MessageType& type, std::string_view topic,
                             const QosProfile& profile) {
  return make_endpoint(&dds_create_writer, participant, type, topic, profile);
}

}  // namespace calib
