#include "dds/discovery.hpp"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <string_view>

#include "dds/names.hpp"

namespace calib {
namespace {

/// An untrusted name, cut to the longest that ROS and DDS allow.
std::string short_text(const char* name) { return std::string(std::string_view(name).substr(0, 300)); }

std::string partition_of(const dds_qos_t* qos) {
  std::uint32_t count = 0;
  char** names = nullptr;
  if (!dds_qget_partition(qos, &count, &names)) return {};
  std::string first = count > 0 ? short_text(names[0]) : "";
  for (std::uint32_t i = 0; i < count; ++i) {
    if (*names[i] == '\0' || std::string_view(names[i]) == "*") first.clear();  // the default partition is one of them
    dds_free(names[i]);
  }
  dds_free(names);
  return first;
}

bool offers_xcdr1(const dds_qos_t* qos) {
  std::uint32_t count = 0;
  dds_data_representation_id_t* ids = nullptr;
  if (!dds_qget_data_representation(qos, &count, &ids) || count == 0) return true;
  // A writer uses the first representation that it offers.
  const bool offers = ids[0] == DDS_DATA_REPRESENTATION_XCDR1;
  dds_free(ids);
  return offers;
}

/// Reliability, durability, deadline, liveliness and order match any offer: calibd requests the weakest of each.
std::string obstacle_of(const dds_qos_t* qos) {
  if (const std::string partition = partition_of(qos); !partition.empty())
    return "it publishes in the DDS partition '" + partition + "' only, and calibd reads the default partition";
  dds_ownership_kind_t ownership = DDS_OWNERSHIP_SHARED;
  if (dds_qget_ownership(qos, &ownership) && ownership == DDS_OWNERSHIP_EXCLUSIVE)
    return "its ownership is exclusive, and ROS 2 readers request shared";
  dds_duration_t latency = 0;
  if (dds_qget_latency_budget(qos, &latency) && latency > 0)
    return "its latency budget is not zero, and ROS 2 readers request zero";
  if (!offers_xcdr1(qos)) return "it sends XCDR2, and ROS 2 readers request XCDR1";
  return {};
}

RemoteWriter described(const dds_builtintopic_endpoint_t& endpoint) {
  RemoteWriter writer{ros_topic_name(short_text(endpoint.topic_name)), ros_type_name(short_text(endpoint.type_name)),
                      false, obstacle_of(endpoint.qos)};
  dds_reliability_kind_t reliability = DDS_RELIABILITY_BEST_EFFORT;
  dds_duration_t blocking = 0;
  writer.reliable =
      dds_qget_reliability(endpoint.qos, &reliability, &blocking) && reliability == DDS_RELIABILITY_RELIABLE;
  return writer;
}

}  // namespace

Result<std::vector<RemoteWriter>> remote_writers(dds_entity_t participant) {
  const auto reader =
      own(dds_create_reader(participant, DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr), "discovery");
  if (!reader) return propagate(reader);
  dds_guid_t self{};
  if (const auto known = check(dds_get_guid(participant, &self), "discovery"); !known) return propagate(known);
  std::vector<RemoteWriter> writers;
  std::array<void*, 64> samples{};
  std::array<dds_sample_info_t, 64> infos;
  for (dds_return_t taken = 1; taken > 0 && writers.size() < max_remote_writers;) {
    taken = dds_take(reader->get(), samples.data(), infos.data(), samples.size(), samples.size());
    if (const auto took = check(taken, "discovery"); !took) return propagate(took);
    for (std::size_t i = 0; i < static_cast<std::size_t>(taken); ++i) {
      const auto& endpoint = *static_cast<const dds_builtintopic_endpoint_t*>(samples[i]);
      const bool alive = infos[i].valid_data && infos[i].instance_state == DDS_IST_ALIVE;
      if (alive && std::memcmp(&endpoint.participant_key, &self, sizeof self) != 0)
        writers.push_back(described(endpoint));
    }
    if (taken > 0) dds_return_loan(reader->get(), samples.data(), taken);
  }
  std::ranges::sort(writers, {}, &RemoteWriter::topic);
  return writers;
}

}  // namespace calib
