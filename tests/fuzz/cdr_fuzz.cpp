#include <dds/ddsi/ddsi_cdrstream.h>

#include <array>
#include <cstring>

#include "dds/decode.hpp"
#include "dds/messages.hpp"
#include "fuzz/fuzz.hpp"
#include "support/ros_messages.hpp"

/// The bytes of a sample as a peer sends them, through what Cyclone does to them when they arrive and when calibd
/// takes them (dds_stream_normalize, dds_stream_read), without its network, and through calibd's decoder.

namespace calib::fuzz {

constexpr std::size_t header_bytes = 4;
constexpr std::uint32_t xcdr1 = 1, xcdr2 = 2;  // as dds_istream_t has them

template <typename Message>
const Message& as(const void* sample) {
  return *static_cast<const Message*>(sample);
}

template <typename Value>
void check(const Result<Value>& decoded) {
  require(decoded.has_value() || is_malformed(decoded.error().code));
}

struct Type {
  const dds_topic_descriptor_t* descriptor;
  void (*decode)(const void* sample);
};
const std::array<Type, 8> types{{
    {image_type.descriptor,
     [](const void* s) { check(decode_image(as<sensor_msgs_msg_dds__Image_>(s), Colour::rgb)); }},
    {compressed_image_type.descriptor,
     [](const void* s) { check(decode_compressed_image(as<sensor_msgs_msg_dds__CompressedImage_>(s), Colour::rgb)); }},
    {cloud_type.descriptor, [](const void* s) { check(decode_cloud(as<sensor_msgs_msg_dds__PointCloud2_>(s))); }},
    {camera_info_type.descriptor,
     [](const void* s) { check(decode_camera_info(as<sensor_msgs_msg_dds__CameraInfo_>(s))); }},
    {disparity_image_type.descriptor,
     [](const void* s) { check(decode_disparity(as<stereo_msgs_msg_dds__DisparityImage_>(s))); }},
    {imu_type.descriptor, [](const void* s) { check(decode_imu(as<sensor_msgs_msg_dds__Imu_>(s))); }},
    {odometry_type.descriptor, [](const void* s) { check(decode_odometry(as<nav_msgs_msg_dds__Odometry_>(s))); }},
    {image_type.descriptor, [](const void* s) { check(decode_depth(as<sensor_msgs_msg_dds__Image_>(s))); }},
}};

/// A sample in memory, with all that Cyclone allocated for it.
class Sample {
 public:
  explicit Sample(const dds_topic_descriptor_t& type) : type_(type), memory_(dds_alloc(type.m_size)) {
    std::memset(memory_, 0, type.m_size);
  }
  Sample(const Sample&) = delete;
  Sample& operator=(const Sample&) = delete;
  ~Sample() { dds_sample_free(memory_, &type_, DDS_FREE_ALL); }

  /// False: these bytes are no sample of the type, and Cyclone drops them.
  [[nodiscard]] bool read(Octets cdr, bool swap, std::uint32_t xcdr) {
    std::uint32_t used = 0;
    cdr.reserve(1);  // Cyclone wants an address of nothing too
    const auto size = static_cast<std::uint32_t>(cdr.size());
    char* const data = reinterpret_cast<char*>(cdr.data());
    if (dds_stream_normalize_data(data, &used, size, swap, xcdr, type_.m_ops) == nullptr) return false;
    require(used <= size);
    dds_istream_t in;
    dds_istream_init(&in, used, data, xcdr);
    dds_stream_read(&in, static_cast<char*>(memory_), type_.m_ops);
    require(in.m_index <= used);
    return true;
  }
  [[nodiscard]] const void* get() const { return memory_; }

 private:
  const dds_topic_descriptor_t& type_;
  void* memory_;
};

Octets write(const dds_topic_descriptor_t& type, const void* sample) {
  dds_ostream_t out;
  dds_ostream_init(&out, 0, xcdr1);
  require(dds_stream_write(&out, static_cast<const char*>(sample), type.m_ops) != nullptr);
  const Octets bytes(out.m_buffer, out.m_buffer + out.m_index);
  dds_ostream_fini(&out);
  return bytes;
}

std::vector<Octets> seeds() {
  std::vector<Octets> all;
  const auto add = [&](std::uint8_t type, const auto& message) {
    const std::array<std::uint8_t, header_bytes> little_endian{0, 1, 0, 0};
    all.push_back(Output().put(type).put(little_endian).with(write(*types.at(type).descriptor, &message)));
  };
  test::ImageMessage image;
  add(0, image.raw());
  test::CompressedImageMessage compressed;
  compressed.data = octets("\xFF\xD8\xFF");
  add(1, compressed.raw());
  test::CloudMessage cloud;
  add(2, cloud.raw());
  test::CameraInfoMessage camera_info;
  add(3, camera_info.raw());
  test::DisparityMessage disparity;
  add(4, disparity.raw());
  test::ImuMessage imu;
  add(5, imu.raw());
  test::OdometryMessage odometry;
  add(6, odometry.raw());
  image.encoding = "16UC1";
  image.step = 12;
  image.data.resize(48);
  add(7, image.raw());
  return all;
}

}  // namespace calib::fuzz

/// Which type, the four bytes that tell the encoding, the sample.
int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
  using namespace calib::fuzz;
  Input input(bytes, size);
  const Type& type = types[input.take<std::uint8_t>() % types.size()];
  const auto header = input.take<std::array<std::uint8_t, header_bytes>>();
  // Plain CDR or XCDR2, big or little endian; no type here is of another kind.
  if (header[0] != 0 || (header[1] > 1 && header[1] != 6 && header[1] != 7)) return 0;
  const bool swap = header[1] % 2 == 0;
  const std::uint32_t xcdr = header[1] < 2 ? xcdr1 : xcdr2;
  Sample sample(*type.descriptor);
  if (!sample.read(input.rest(), swap, xcdr)) return 0;
  type.decode(sample.get());
  // What was taken is what was sent.
  const Octets written = write(*type.descriptor, sample.get());
  Sample again(*type.descriptor);
  require(again.read(written, false, xcdr1));
  require(write(*type.descriptor, again.get()) == written);
  return 0;
}
