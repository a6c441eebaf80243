#include "dataset/depth_files.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstring>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "calib/file.hpp"
#include "dataset/encoded_image.hpp"
#include "vehicle/random.hpp"

namespace calib {
namespace {

namespace fs = std::filesystem;

tl::unexpected<Error> unreadable(const fs::path& path, const std::string& why) {
  return fail(ErrorCode::depth_unreadable, path.string() + " " + why);
}

/// The text after `key` in the header of an .npy file, which is written as a Python dictionary.
std::string_view after(std::string_view header, std::string_view key) {
  const auto at = header.find(key);
  if (at == std::string_view::npos) return {};
  header.remove_prefix(at + key.size());
  header.remove_prefix(std::min(header.find_first_not_of(": "), header.size()));
  return header;
}

/// NumPy's format, versions 1 to 3: magic, version, length of the header, the header, then the values.
Result<cv::Mat> read_npy(const fs::path& path) {
  constexpr std::uint64_t most_bytes = 256 << 20;
  const auto read = read_regular_file(path, most_bytes);
  if (!read) return fail(ErrorCode::depth_unreadable, read.error().context);
  const std::string& bytes = *read;
  constexpr std::string_view magic = "\x93NUMPY";
  if (!bytes.starts_with(magic) || bytes.size() < 12) return unreadable(path, "is not an .npy file");
  const auto byte = [&](std::size_t i) { return static_cast<std::size_t>(static_cast<std::uint8_t>(bytes[i])); };
  const std::size_t start = byte(6) == 1 ? 10 : 12;
  const std::size_t length = byte(8) | byte(9) << 8 | (start == 12 ? byte(10) << 16 | byte(11) << 24 : 0);
  if (length > bytes.size() - start) return unreadable(path, "is cut off");
  const std::string_view header = std::string_view(bytes).substr(start, length);
  std::string_view shape = after(header, "'shape'");
  int rows = 0, columns = 0;
  if (shape.starts_with("(")) {
    const auto [comma, error] = std::from_chars(shape.data() + 1, shape.data() + shape.size(), rows);
    shape.remove_prefix(comma - shape.data());
    if (error == std::errc() && shape.starts_with(", ")) {
      const auto [end, second] = std::from_chars(shape.data() + 2, shape.data() + shape.size(), columns);
      if (second != std::errc() || end == shape.data() + shape.size() || *end != ')') columns = 0;
    }
  }
  if (!after(header, "'descr'").starts_with("'<f4'") || !after(header, "'fortran_order'").starts_with("False") ||
      rows < 1 || columns < 1 || rows > 65536 || columns > 65536)
    return unreadable(path,
                      "is not a two-dimensional array of little-endian float32 in C order; "
                      "save it with numpy.ascontiguousarray(depth, '<f4')");
  // Before memory is taken for them.
  const std::size_t size =
      std::size_t{sizeof(float)} * static_cast<std::size_t>(rows) * static_cast<std::size_t>(columns);
  if (bytes.size() - start - length != size) return unreadable(path, "does not hold as many values as its shape says");
  cv::Mat values(rows, columns, CV_32FC1);
  std::memcpy(values.data, bytes.data() + start + length, size);
  return values;
}

/// Stored values as floats, not yet scaled, and the scale that is usual for how they are stored.
struct Stored {
  cv::Mat values;
  double usual_scale;
};

Result<Stored> read_stored(const fs::path& path) {
  if (path.extension() == ".npy") return read_npy(path).map([](const cv::Mat& values) { return Stored{values, 1}; });
  const auto encoded = EncodedImage::read(path, ErrorCode::depth_unreadable);
  if (!encoded) return propagate(encoded);
  cv::Mat image = encoded->decode(cv::IMREAD_UNCHANGED);
  if (image.empty()) return unreadable(path, "is damaged");
  if (image.type() != CV_16UC1 && image.type() != CV_32FC1)
    return unreadable(path, "is neither 16-bit nor 32-bit float with one channel");
  const double usual_scale = image.type() == CV_16UC1 ? 256 : 1;
  image.convertTo(image, CV_32F);
  return Stored{image, usual_scale};
}

std::optional<fs::path> find_file(const fs::path& folder, const std::string& name) {
  std::error_code error;
  for (const char* extension : {".png", ".npy", ".tif", ".tiff", ".pfm"})
    if (fs::path path = folder / (name + extension); fs::is_regular_file(path, error)) return path;
  return std::nullopt;
}

/// A polynomial of degree 1 .. 3 over [-1, 1] x [-1, 1].
class SmoothField {
 public:
  explicit SmoothField(std::uint64_t seed) {
    vehicle::Random random(seed);
    for (float& value : coefficients_) value = random.gaussian();
  }
  [[nodiscard]] double at(double u, double v) const {
    const auto& c = coefficients_;
    return u * (c[0] + u * (c[1] + u * c[2])) + v * (c[3] + v * (c[4] + v * c[5])) +
           u * v * (c[6] + u * c[7] + v * c[8]);
  }

 private:
  std::array<float, 9> coefficients_{};
};

}  // namespace

Result<DepthKind> parse_depth_kind(std::string_view name) {
  if (name == "disparity") return DepthKind::disparity;
  if (name == "inverse") return DepthKind::inverse;
  if (name == "depth") return DepthKind::depth;
  if (name == "range") return DepthKind::range;
  return fail(ErrorCode::unknown_depth_kind,
              "depth kind '" + escape_control(name) + "' is not known; use disparity, inverse, depth or range");
}

Result<DepthMap> read_depth(const DepthFolder& depth, const std::string& frame_name, const Camera& camera,
                            std::optional<double> baseline_m) {
  const auto path = find_file(depth.folder, frame_name);
  if (!path)
    return fail(ErrorCode::depth_missing,
                depth.folder.string() + " has no depth of frame " + frame_name + " (.png, .npy, .tif, .tiff or .pfm)");
  auto stored = read_stored(*path);
  if (!stored) return propagate(stored);
  cv::Mat& values = stored->values;

  double factor = 1 / depth.scale.value_or(stored->usual_scale);
  if (depth.kind == DepthKind::disparity && baseline_m)  // 1/z = d / (f B), f in pixels of the file
    factor *= camera.width() / (camera.fx() * *baseline_m * values.cols);
  if (values.cols != camera.width() || values.rows != camera.height()) {
    const double across = static_cast<double>(values.cols) / camera.width(),
                 down = static_cast<double>(values.rows) / camera.height();
    if (std::abs(across / down - 1) > 0.02)
      return unreadable(*path, "is " + std::to_string(values.cols) + " x " + std::to_string(values.rows) +
                                   ", which is not the shape of the image, " + std::to_string(camera.width()) + " x " +
                                   std::to_string(camera.height()));
    cv::resize(values, values, {camera.width(), camera.height()}, 0, 0, cv::INTER_NEAREST);
  }

  const bool grows_with_distance = depth.kind == DepthKind::depth || depth.kind == DepthKind::range;
  DepthMap map;
  map.width = camera.width();
  map.height = camera.height();
  map.along_ray = depth.kind == DepthKind::range;
  map.inverse_depth.reserve(values.total());
  for (const float raw : cv::Mat_<float>(values)) {
    const auto value = static_cast<float>(raw * factor);
    const float inverse = grows_with_distance ? 1 / value : value;
    map.inverse_depth.push_back(value > 0 && std::isfinite(inverse) && inverse > 0 ? inverse : DepthMap::no_depth);
  }
  if (std::ranges::none_of(map.inverse_depth, [](float inverse) { return inverse > 0; }))
    return fail(ErrorCode::depth_empty, path->string() + " holds no valid depth");
  return map;
}

void add_smooth_bias(DepthMap& depth, double amplitude, std::uint64_t seed) {
  const SmoothField field(seed);
  const auto value = [&](int x, int y) {
    return field.at((2.0 * x + 1) / depth.width - 1, (2.0 * y + 1) / depth.height - 1);
  };
  double largest = 0;
  for (int y = 0; y < depth.height; ++y)
    for (int x = 0; x < depth.width; ++x) largest = std::max(largest, std::abs(value(x, y)));
  if (largest == 0) return;
  for (int y = 0; y < depth.height; ++y)
    for (int x = 0; x < depth.width; ++x)
      depth.inverse_depth[y * depth.width + x] /= static_cast<float>(1 + amplitude / largest * value(x, y));
}

Result<void> write_range_png(const fs::path& path, int width, int height, const std::vector<float>& range_m) {
  cv::Mat_<std::uint16_t> pixels(height, width);
  std::ranges::transform(range_m, pixels.begin(), [](float range) {
    const float value = std::round(256 * range);
    return static_cast<std::uint16_t>(value > 0 && value < 65536 ? value : 0);
  });
  return write_encoded(path, pixels);
}

}  // namespace calib
