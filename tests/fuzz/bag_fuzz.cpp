#include <zstd.h>

#include "dataset/bag/bag_frames.hpp"
#include "dataset/bag/ros_message.hpp"
#include "dataset/bag/transform_tree.hpp"
#include "fuzz/fuzz.hpp"
#include "fuzz/scratch.hpp"
#include "support/mcap_bytes.hpp"

/// A file of rosbag2: MCAP, SQLite, or either compressed; and each message that it lists, through what makes samples of
/// it.

namespace calib::fuzz {

using test::McapBytes;

McapBytes records() {
  return McapBytes()
      .schema(1, bag_type::cloud)
      .schema(2, bag_type::transforms)
      .channel(1, 1, "/points")
      .channel(2, 2, "/tf_static")
      .message(1, test::stamped_cdr(10, 1))
      .message(2, {0, 1, 0, 0, 0, 0, 0, 0});
}

Octets compressed(const Octets& plain) {
  Octets bytes(ZSTD_compressBound(plain.size()));
  bytes.resize(ZSTD_compress(bytes.data(), bytes.size(), plain.data(), plain.size(), 1));
  return bytes;
}

std::vector<Octets> seeds() {
  const auto file = [](const auto& add) {
    McapBytes bytes;
    bytes.magic().header();
    add(bytes);
    return bytes.end().octets();
  };
  const Octets plain = file([](McapBytes& bytes) { bytes.chunk(records()); });
  return {plain, file([](McapBytes& bytes) { bytes.raw(records().octets()); }), file([](McapBytes& bytes) {
            bytes.chunk(McapBytes().raw(compressed(records().octets())), "zstd", records().octets().size());
          }),
          compressed(plain)};
}

template <typename Value>
void check(const Result<Value>& decoded) {
  require(decoded.has_value() || is_malformed(decoded.error().code));
}

void decode(const BagTopic& topic, const Octets& bytes) {
  if (topic.is(bag_type::cloud)) check(cloud_in(bytes));
  if (topic.is(bag_type::camera_info)) check(info_in(bytes));
  if (topic.is(bag_type::image) || topic.is(bag_type::compressed_image))
    check(image_in(bytes, topic, Colour::none, {}));
  if (topic.is(bag_type::disparity)) check(depth_in(bytes, topic, {}));
  if (!topic.is(bag_type::transforms)) return;
  const auto message = RosMessage::read(bytes, transforms_type);
  check(message);
  TransformTree tree;
  if (message) tree.add(message->as<tf2_msgs_msg_dds__TFMessage_>(), TransformTree::Topic::tf_static);
  if (const auto found = tree.find("a", "b")) require(found->matrix().allFinite());
}

}  // namespace calib::fuzz

int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  using namespace calib;
  const auto bag = open_bag_storage(fuzz::scratch().write("bag", fuzz::text(bytes, size)));
  if (!bag) {
    fuzz::require_code(bag.error(), {ErrorCode::file_unreadable});
    return 0;
  }
  std::size_t most = 100;
  for (const BagMessage& message : (*bag)->messages()) {
    fuzz::require(message.topic < (*bag)->topics().size());
    const auto read = (*bag)->read(message);
    if (read)
      fuzz::decode((*bag)->topics()[message.topic], *read);
    else
      fuzz::require_code(read.error(), {ErrorCode::file_unreadable});
    if (--most == 0) break;
  }
  return 0;
}
