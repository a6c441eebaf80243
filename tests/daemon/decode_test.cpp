#include "dds/decode.hpp"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <opencv2/imgcodecs.hpp>
#include <random>

#include "support/catch.hpp"
#include "support/ros_messages.hpp"
#include "support/support.hpp"

using namespace calib;
using namespace calib::test;

namespace {

constexpr double not_a_number = std::numeric_limits<double>::quiet_NaN();
constexpr double infinity = std::numeric_limits<double>::infinity();

Result<Image> decode(ImageMessage& message) { return decode_image(message.raw()); }
Result<Image> decode(CompressedImageMessage& message) { return decode_compressed_image(message.raw()); }
Result<DecodedCloud> decode(CloudMessage& message) { return decode_cloud(message.raw()); }
Result<CameraInfo> decode(CameraInfoMessage& message) { return decode_camera_info(message.raw()); }

/// One bound: what is still taken, and what is refused with `code`.
template <typename Message>
struct Bound {
  std::string code;
  std::function<void(Message&)> inside, outside;
};

template <typename Message>
void check_bounds(const Message& good, const std::vector<Bound<Message>>& bounds) {
  for (const auto& bound : bounds) {
    INFO(bound.code);
    Message inside = good, outside = good;
    bound.inside(inside);
    bound.outside(outside);
    const auto taken = decode(inside);
    CHECK((taken ? "" : word(taken.error().code) + ": " + taken.error().context) == "");
    const auto refused = decode(outside);
    CHECK((refused ? "taken" : word(refused.error().code)) == bound.code);
  }
}

}  // namespace

TEST_CASE("an image one step outside of a bound is refused with the name of the bound") {
  check_bounds<ImageMessage>(
      {},
      {{"malformed:stamp", [](auto& m) { m.nanosec = 999'999'999; }, [](auto& m) { m.nanosec = 1'000'000'000; }},
       {"malformed:stamp", [](auto& m) { m.sec = 0; }, [](auto& m) { m.sec = -1; }},
       {"malformed:encoding", [](auto& m) { m.encoding = "8UC1"; }, [](auto& m) { m.encoding = "8UC2"; }},
       {"malformed:encoding", [](auto&) {}, [](auto& m) { m.encoding = ""; }},
       {"malformed:depth_encoding", [](auto&) {}, [](auto& m) { m.encoding = "16UC1"; }},
       {"malformed:depth_encoding", [](auto&) {}, [](auto& m) { m.encoding = "32FC1"; }},
       {"malformed:image_size", [](auto& m) { m.width = m.height = m.step = 1; }, [](auto& m) { m.width = 0; }},
       {"malformed:image_size", [](auto&) {}, [](auto& m) { m.height = 0; }},
       {"malformed:image_size",
        [](auto& m) {
          m.width = m.step = 64'000'000, m.height = 1;
          m.data.resize(64'000'000);
        },
        [](auto& m) {
          m.width = m.step = 64'000'001, m.height = 1;
          m.data.resize(64'000'001);
        }},
       // products that would pass in 32 bits
       {"malformed:image_size", [](auto&) {}, [](auto& m) { m.width = m.height = 0x10000; }},
       {"malformed:step", [](auto& m) { m.step = 6; }, [](auto& m) { m.step = 5, m.data.resize(20); }},
       {"malformed:step",
        [](auto& m) {
          m.encoding = "rgb8", m.step = 18;
          m.data.resize(72);
        },
        [](auto& m) {
          m.encoding = "rgb8", m.step = 17;
          m.data.resize(71);
        }},
       {"malformed:image_data", [](auto& m) { m.data.resize(24); }, [](auto& m) { m.data.resize(23); }},
       {"malformed:image_data", [](auto&) {}, [](auto& m) { m.step = 0x40000000, m.data.resize(25); }},
       {"malformed:step",
        [](auto& m) {
          m.step = 6 + 4096;
          m.data.resize(4 * m.step);
        },
        [](auto& m) {
          m.step = 6 + 4097;
          m.data.resize(4 * m.step);
        }},
       {"malformed:image_data", [](auto& m) { m.data.resize(24 + 65536); }, [](auto& m) { m.data.resize(24 + 65537); }},
       {"malformed:image_data", [](auto&) {},
        [](auto& m) {
          m.width = m.height = m.step = 1;
          m.data.resize(200'000'000);
        }}});
}

TEST_CASE("a compressed image outside of a bound is refused with the name of the bound") {
  CompressedImageMessage good;
  REQUIRE(cv::imencode(".png", cv::Mat(8, 8, CV_8UC1, cv::Scalar(9)), good.data));
  const auto png_size = [](std::uint32_t width, std::uint32_t height) {
    return [=](CompressedImageMessage& m) {
      for (int i = 0; i < 4; ++i) {
        m.data[16 + i] = static_cast<std::uint8_t>(width >> (24 - 8 * i));
        m.data[20 + i] = static_cast<std::uint8_t>(height >> (24 - 8 * i));
      }
    };
  };
  const auto same = [](CompressedImageMessage&) {};
  check_bounds<CompressedImageMessage>(
      good, {{"malformed:stamp", same, [](auto& m) { m.nanosec = 1'000'000'000; }},
             {"malformed:depth_encoding", [](auto& m) { m.format = "mono8; png compressed "; },
              [](auto& m) { m.format = "16UC1; png compressed "; }},
             {"malformed:compressed_size", [](auto& m) { m.data.resize(8 * 8 * 4 + 65536); },
              [](auto& m) { m.data.resize(8 * 8 * 4 + 65537); }},
             {"malformed:compressed_size", same, [](auto& m) { m.data.resize(32'000'001); }},
             {"malformed:compressed_size", same, [](auto& m) { m.data.clear(); }},
             {"malformed:compressed_format", same, [](auto& m) { m.data[0] ^= 1; }},
             {"malformed:compressed_dimensions", same, png_size(0, 8)},
             {"malformed:compressed_dimensions", same, png_size(8, 0)},
             {"malformed:compressed_dimensions", same, png_size(64'000'001, 1)},
             {"malformed:compressed_dimensions", same, png_size(0xFFFFFFFF, 0xFFFFFFFF)},
             {"malformed:compressed_dimensions", same, [](auto& m) { m.data.resize(20); }},
             {"malformed:compressed_data", same, [](auto& m) { m.data.resize(40); }},
             {"malformed:compressed_data", same, png_size(8, 9)}});
}

TEST_CASE("a cloud one step outside of a bound is refused with the name of the bound") {
  const auto single_point = [](std::uint32_t point_step) {
    return [=](CloudMessage& m) {
      m.width = m.height = 1;
      m.point_step = m.row_step = point_step;
      m.data.resize(point_step);
    };
  };
  const auto many_points = [](std::uint32_t width) {
    return [=](CloudMessage& m) {
      m.width = width, m.height = 1, m.row_step = width * 16;
      m.data.resize(std::size_t{width} * 16);
    };
  };
  const auto with_fields = [](std::size_t count) {
    return [=](CloudMessage& m) {
      while (m.fields.size() < count) m.fields.push_back({"ring", 0, 2});
    };
  };
  const auto with = [](CloudField field) { return [=](CloudMessage& m) { m.fields.push_back(field); }; };
  const auto same = [](CloudMessage&) {};
  check_bounds<CloudMessage>(
      {},
      {{"malformed:stamp", [](auto& m) { m.nanosec = 999'999'999; }, [](auto& m) { m.nanosec = 1'000'000'000; }},
       {"malformed:point_step", single_point(4096), single_point(4097)},
       {"malformed:point_step", same, [](auto& m) { m.point_step = 0; }},
       {"malformed:cloud_size", many_points(4'000'000), many_points(4'000'001)},
       {"malformed:cloud_size", same, [](auto& m) { m.width = m.height = 0x10000; }},
       {"malformed:fields", with_fields(64), with_fields(65)},
       {"malformed:field_type", same, [](auto& m) { m.fields[2].datatype = 9; }},
       {"malformed:field_type", same, [](auto& m) { m.fields[2].datatype = 0; }},
       {"malformed:field_bounds", [](auto& m) { m.fields[2].offset = 12; }, [](auto& m) { m.fields[2].offset = 13; }},
       {"malformed:field_bounds", same, [](auto& m) { m.fields[2].count = 3; }},
       {"malformed:field_bounds", same, [](auto& m) { m.fields[2].count = 0xFFFFFFFF; }},
       {"malformed:field_bounds", same, [](auto& m) { m.fields[2].offset = 0xFFFFFFFF; }},
       {"malformed:xyz", same, [](auto& m) { m.fields.erase(m.fields.begin() + 1); }},
       {"malformed:xyz", same, with({"z", 8})},
       {"malformed:xyz", same, [](auto& m) { m.fields[0].datatype = 5; }},
       {"malformed:xyz", same, [](auto& m) { m.fields[0].count = 2; }},
       {"malformed:row_step", [](auto& m) { m.row_step = 48; }, [](auto& m) { m.row_step = 47, m.data.resize(95); }},
       // 3 points of 48 + 48 bytes; the last row needs no padding
       {"malformed:cloud_data",
        [](auto& m) {
          m.row_step = 50;
          m.data.insert(m.data.begin() + 48, 2, 0);
        },
        [](auto& m) {
          m.row_step = 50;
          m.data.insert(m.data.begin() + 48, 1, 0);
        }},
       {"malformed:cloud_data", [](auto& m) { m.data.resize(96); }, [](auto& m) { m.data.resize(95); }},
       {"malformed:row_step",
        [](auto& m) {
          m.row_step = 48 + 4096;
          m.data.resize(2 * m.row_step);
        },
        [](auto& m) {
          m.row_step = 48 + 4097;
          m.data.resize(2 * m.row_step);
        }},
       {"malformed:cloud_data", [](auto& m) { m.data.resize(96 + 4096 + 65536); },
        [](auto& m) { m.data.resize(96 + 4096 + 65537); }},
       {"malformed:cloud_data",
        [](auto& m) {
          m.width = 0;
          m.data.resize(65536);
        },
        [](auto& m) {
          m.width = 0;
          m.data.resize(65537);
        }},
       {"malformed:cloud_data", same, [](auto& m) { m.row_step = 0xFFFFFFFF, m.data.resize(97); }}});
}

TEST_CASE("a CameraInfo outside of a bound is refused with the name of the bound") {
  const auto same = [](CameraInfoMessage&) {};
  const auto model = [](std::string name, std::size_t count) {
    return [=](CameraInfoMessage& m) {
      m.distortion_model = name;
      m.d.assign(count, 0.01);
    };
  };
  check_bounds<CameraInfoMessage>(
      {}, {{"malformed:stamp", same, [](auto& m) { m.sec = -1; }},
           {"malformed:image_size", [](auto& m) { m.width = 64'000'000, m.height = 1; },
            [](auto& m) { m.width = 64'000'001, m.height = 1; }},
           {"malformed:image_size", same, [](auto& m) { m.width = 0; }},
           {"malformed:intrinsics", [](auto& m) { m.k[0] = 1.001; }, [](auto& m) { m.k[0] = 1; }},
           {"malformed:intrinsics", [](auto& m) { m.k[4] = 99'999; }, [](auto& m) { m.k[4] = 1e5; }},
           {"malformed:intrinsics", same, [](auto& m) { m.k[0] = not_a_number; }},
           {"malformed:intrinsics", same, [](auto& m) { m.k[2] = infinity; }},
           {"malformed:intrinsics", same, [](auto& m) { m.p[3] = not_a_number; }},
           {"malformed:intrinsics", [](auto& m) { m.k = {}; }, [](auto& m) { m.k = {}, m.p[5] = 1; }},
           {"malformed:uncalibrated", [](auto& m) { m.p = {}; }, [](auto& m) { m.k = {}, m.p = {}; }},
           {"malformed:uncalibrated", same, [](auto& m) { m.k = {}, m.p = {}, m.width = m.height = 0; }},
           {"malformed:distortion", model("plumb_bob", 4), model("plumb_bob", 3)},
           {"malformed:distortion", model("plumb_bob", 5), model("plumb_bob", 6)},
           {"malformed:distortion", model("rational_polynomial", 8), model("rational_polynomial", 7)},
           {"malformed:distortion", model("rational_polynomial", 8), model("rational_polynomial", 14)},
           {"malformed:distortion", model("equidistant", 4), model("equidistant", 5)},
           {"malformed:distortion", model("fisheye", 4), model("fisheye", 5)},
           {"malformed:distortion", model("none", 0), model("none", 5)},
           {"malformed:distortion", model("", 0), model("", 1)},
           {"malformed:distortion", [](auto& m) { m.d.resize(8, 0.0); }, [](auto& m) { m.d.resize(8, 1e-9); }},
           {"malformed:distortion", same, model("pancake", 5)},
           {"malformed:distortion", same, [](auto& m) { m.d[1] = not_a_number; }},
           {"malformed:roi", [](auto& m) { m.roi_x = 600, m.roi_width = 40; },
            [](auto& m) { m.roi_x = 600, m.roi_width = 41; }},
           {"malformed:roi", [](auto& m) { m.roi_y = 479; }, [](auto& m) { m.roi_y = 480; }},
           {"malformed:roi", same, [](auto& m) { m.roi_x = 0xFFFFFFFF, m.roi_width = 2; }},
           {"malformed:roi", [](auto& m) { m.binning_y = m.roi_height = 10; },
            [](auto& m) { m.binning_y = 11, m.roi_height = 10; }},
           // 500 pixels become 1.002, or no more than 1
           {"malformed:intrinsics", [](auto& m) { m.binning_x = 499; }, [](auto& m) { m.binning_x = 500; }}});
}

namespace {

/// Draws numbers that lie where arithmetic goes wrong.
class Corruption {
 public:
  explicit Corruption(std::uint32_t seed) : random_(seed) {}
  int below(int limit) { return std::uniform_int_distribution(0, limit - 1)(random_); }
  std::uint32_t number() {
    constexpr std::uint32_t edges[] = {0,    1,    2,      3,       5,          15,         16,         17,        47,
                                       4096, 4097, 0xFFFF, 0x10000, 0x7FFFFFFF, 0x80000000, 0xFFFFFFF0, 0xFFFFFFFF};
    return below(4) == 0 ? static_cast<std::uint32_t>(random_()) : edges[below(std::size(edges))];
  }
  double real() {
    const double edges[] = {0, -1, 1, 1e5, 1e300, not_a_number, infinity, -infinity, 500};
    return edges[below(std::size(edges))];
  }
  std::string word() {
    const std::string words[] = {"",          "x",
                                 "y",         "z",
                                 "intensity", "mono8",
                                 "rgb8",      "bayer_rggb8",
                                 "mono16",    "16UC1",
                                 "uyvy",      "plumb_bob",
                                 "\x1b[2J",   std::string(5000, 'a'),
                                 "8UC4"};
    return words[below(std::size(words))];
  }
  void spoil(Octets& bytes) {
    if (below(2) == 0) bytes.resize(below(200));
    for (int i = below(8); i > 0 && !bytes.empty(); --i)
      bytes[below(static_cast<int>(bytes.size()))] ^= static_cast<std::uint8_t>(1 << below(8));
  }

 private:
  std::mt19937 random_;
};

/// Whatever happens, it is a value within its bounds or a code that the table in decode.hpp lists.
template <typename Value>
void check_outcome(const Result<Value>& result, const std::function<bool(const Value&)>& sound) {
  static const std::vector<std::string> codes{"stamp",
                                              "encoding",
                                              "depth_encoding",
                                              "image_size",
                                              "step",
                                              "image_data",
                                              "compressed_size",
                                              "compressed_format",
                                              "compressed_dimensions",
                                              "compressed_data",
                                              "point_step",
                                              "cloud_size",
                                              "cloud_layout",
                                              "uncalibrated",
                                              "fields",
                                              "field_type",
                                              "field_bounds",
                                              "xyz",
                                              "row_step",
                                              "cloud_data",
                                              "intrinsics",
                                              "distortion",
                                              "roi"};
  if (result) {
    REQUIRE(sound(*result));
    return;
  }
  INFO(word(result.error().code));
  REQUIRE(is_malformed(result.error().code));
  REQUIRE(std::ranges::find(codes, word(result.error().code).substr(10)) != codes.end());
  REQUIRE(result.error().context.size() < 500);
}

}  // namespace

TEST_CASE("a randomly corrupted message gives a valid value or a documented error") {
  const std::function sound_image = [](const Image& image) {
    return image.width > 0 && image.height > 0 && image.pixels.size() == std::size_t(image.width) * image.height;
  };
  const std::function sound_scan = [](const DecodedCloud& scan) {
    return std::ranges::all_of(scan.points, [](const LidarPoint& p) {
      return std::hypot(p.x_m, p.y_m, p.z_m) <= 500.001F && std::isfinite(p.reflectance);
    });
  };
  const std::function sound_info = [](const CameraInfo& info) {
    return info.width > 0 && info.height > 0 && (info.K[0] == 0 ? info.P[0] : info.K[0]) > 1 && info.D.size() <= 8;
  };
  Octets jpeg;
  REQUIRE(cv::imencode(".jpg", cv::Mat(16, 16, CV_8UC3, cv::Scalar(9, 99, 200)), jpeg));
  for (std::uint32_t seed = 0; seed < 20'000; ++seed) {
    INFO("seed " << seed);
    Corruption corruption(seed);
    ImageMessage image;
    CloudMessage cloud;
    CameraInfoMessage info;
    CompressedImageMessage compressed;
    compressed.data = jpeg;
    for (int changes = 1 + corruption.below(3); changes > 0; --changes) {
      std::uint32_t* const numbers[] = {&image.width,    &image.height, &image.step,       &image.nanosec,
                                        &cloud.width,    &cloud.height, &cloud.point_step, &cloud.row_step,
                                        &cloud.nanosec,  &info.width,   &info.height,      &compressed.nanosec,
                                        &info.binning_x, &info.roi_x,   &info.roi_height};
      *numbers[corruption.below(std::size(numbers))] = corruption.number();
      CloudField& field = cloud.fields[corruption.below(4)];
      switch (corruption.below(5)) {
        case 0:
          field.offset = corruption.number();
          break;
        case 1:
          field.count = corruption.number();
          break;
        case 2:
          field.datatype = static_cast<std::uint8_t>(corruption.below(12));
          break;
        case 3:
          field.name = corruption.word();
          break;
        default:
          cloud.is_bigendian = !cloud.is_bigendian;
      }
      image.encoding = corruption.word();
      info.distortion_model = corruption.below(2) == 0 ? corruption.word() : info.distortion_model;
      info.k[corruption.below(9)] = corruption.real();
      info.d.resize(corruption.below(16), corruption.real());
      corruption.spoil(image.data);
      corruption.spoil(cloud.data);
      corruption.spoil(compressed.data);
    }
    check_outcome(decode(image), sound_image);
    check_outcome(decode(cloud), sound_scan);
    check_outcome(decode(info), sound_info);
    check_outcome(decode(compressed), sound_image);
  }
}
