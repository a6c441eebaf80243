#include "calib/overlay.hpp"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <opencv2/imgproc.hpp>
#include <string>
#include <utility>

#include "calib/file.hpp"
#include "calib/image_codec.hpp"

namespace calib {
namespace {

/// By the extension of `file`, in either case.
std::optional<Compression> compression_for(const std::filesystem::path& file) {
  std::string extension = file.extension().string();
  for (char& letter : extension) letter = static_cast<char>(std::tolower(static_cast<unsigned char>(letter)));
  if (extension == ".png") return Compression::png;
  if (extension == ".jpg" || extension == ".jpeg" || extension == ".jpe") return Compression::jpeg;
  return std::nullopt;
}

/// From far (blue) to near (red), in RGB.
cv::Mat colour_table() {
  cv::Mat shades(1, 256, CV_8UC1), colours;
  for (int i = 0; i < 256; ++i) shades.at<std::uint8_t>(i) = static_cast<std::uint8_t>(i);
  cv::applyColorMap(shades, colours, cv::COLORMAP_TURBO);
  cv::cvtColor(colours, colours, cv::COLOR_BGR2RGB);
  return colours;
}

/// Half of the colours are for the nearest 17 m.
cv::Vec3b colour_of(double range_m, const cv::Mat& colours) {
  return colours.at<cv::Vec3b>(static_cast<int>(250 * std::exp(-range_m / 25)));
}

cv::Mat points_on_image(const FramePair& pair, const Camera& camera, const RigidTransform& T_camera_lidar,
                        const cv::Mat& colours) {
  const cv::Mat grey(pair.image.height, pair.image.width, CV_8UC1,
                     const_cast<std::uint8_t*>(pair.image.pixels.data()));  // read only
  cv::Mat picture;
  cv::cvtColor(grey, picture, cv::COLOR_GRAY2RGB);
  // One dot in each cell, so that the image is seen between them, however dense the scan is.
  constexpr int cell = 4;
  cv::Mat_<std::uint8_t> taken(picture.rows / cell + 1, picture.cols / cell + 1, std::uint8_t{0});
  const cv::Rect inside({0, 0}, picture.size());  // the image may be smaller than its camera should be
  for (const LidarPoint& point : pair.scan.points) {
    const Eigen::Vector3d p_lidar(point.x_m, point.y_m, point.z_m);
    const auto uv = camera.project(T_camera_lidar * p_lidar);
    if (!uv) continue;
    const cv::Point pixel(cvRound(uv->x()), cvRound(uv->y()));
    if (!inside.contains(pixel) || std::exchange(taken(pixel / cell), 1)) continue;
    cv::circle(picture, pixel, 1, colour_of(p_lidar.norm(), colours), cv::FILLED);
  }
  return picture;
}

/// By rank, since depth may have any scale.
cv::Mat depth_in_colours(const DepthMap& depth, const cv::Mat& colours) {
  cv::Mat picture(depth.height, depth.width, CV_8UC3, cv::Scalar::all(0));
  std::vector<float> sorted;
  std::ranges::copy_if(depth.inverse_depth, std::back_inserter(sorted), [](float d) { return d > DepthMap::no_depth; });
  std::ranges::sort(sorted);
  for (std::size_t i = 0; i < depth.inverse_depth.size(); ++i) {
    const float value = depth.inverse_depth[i];
    if (!(value > DepthMap::no_depth)) continue;
    const auto rank = std::ranges::lower_bound(sorted, value) - sorted.begin();
    picture.at<cv::Vec3b>(static_cast<int>(i) / depth.width, static_cast<int>(i) % depth.width) =
        colours.at<cv::Vec3b>(static_cast<int>(250 * rank / static_cast<std::ptrdiff_t>(sorted.size())));
  }
  return picture;
}

const cv::Scalar background(24, 24, 24), ink(235, 235, 235), faint(170, 170, 170);
constexpr int font = cv::FONT_HERSHEY_SIMPLEX;

/// Text of a picture this wide.
struct Lettering {
  double scale;
  int line, margin;  // height of a line and distance from the edge, pixels
  explicit Lettering(int width)
      : scale(std::clamp(width / 2400.0, 0.36, 1.2)), line(cvRound(34 * scale) + 5), margin(cvRound(12 * scale) + 4) {}

  [[nodiscard]] int width(const std::string& text) const {
    return cv::getTextSize(text, font, scale, 1, nullptr).width;
  }
  /// `text`, cut to `most` pixels. The font has no letters but those of ASCII.
  [[nodiscard]] std::string fitted(std::string text, int most) const {
    for (char& letter : text)
      if (static_cast<unsigned char>(letter) > 126) letter = '?';
    if (width(text) <= most) return text;
    while (!text.empty() && width(text + "...") > most) text.pop_back();
    return text + "...";
  }
  /// With its left end at `x` and its line beginning at `y`.
  void write(cv::Mat& picture, const std::string& text, int x, int y, const cv::Scalar& colour = ink) const {
    cv::putText(picture, text, {x, y + cvRound(0.74 * line)}, font, scale, colour, 1, cv::LINE_AA);
  }
};

/// A bar of the colours from 1 to 100 m, evenly by the logarithm, with numbers of metres below it.
cv::Mat range_legend(int width, const Lettering& letters, const cv::Mat& colours) {
  cv::Mat band(2 * letters.line + letters.margin / 2, width, CV_8UC3, background);
  const std::string label = letters.fitted("range of points [m]", width / 3);
  letters.write(band, label, letters.margin, 0, faint);
  const int left = letters.width(label) + 2 * letters.margin, right = width - 2 * letters.margin;
  if (right - left < 60) return band;
  const auto range_at = [&](int x) { return std::pow(100.0, static_cast<double>(x - left) / (right - left)); };
  for (int x = left; x <= right; ++x)
    cv::line(band, {x, letters.line / 4}, {x, letters.line - 2}, colour_of(range_at(x), colours));
  int free = 0;
  for (const int metres : {1, 2, 5, 10, 20, 50, 100}) {
    const int x = left + cvRound((right - left) * std::log(metres) / std::log(100.0));
    const std::string number = std::to_string(metres);
    const int begin = x - letters.width(number) / 2;
    cv::line(band, {x, letters.line - 2}, {x, letters.line + 2}, ink);
    if (begin < free) continue;
    letters.write(band, number, begin, letters.line);
    free = begin + letters.width(number) + letters.margin;
  }
  return band;
}

cv::Mat heading(const OverlayCaption& caption, int width, const cv::Mat& colours) {
  const Lettering letters(width);
  const int most = width - 2 * letters.margin;
  cv::Mat band(letters.margin + static_cast<int>(caption.lines.size() + 1) * letters.line, width, CV_8UC3, background);
  int y = letters.margin / 2;
  letters.write(band, letters.fitted(caption.title, most), letters.margin, y);
  for (const std::string& line : caption.lines) {
    y += letters.line;
    letters.write(band, letters.fitted(line, most), letters.margin, y, faint);
  }
  cv::vconcat(band, range_legend(width, letters, colours), band);
  return band;
}

cv::Mat depth_heading(int width) {
  const Lettering letters(width);
  cv::Mat band(letters.line + 4, width, CV_8UC3, background);
  letters.write(band,
                letters.fitted("depth of the image: near red, far blue, by rank, whatever its scale; black: none",
                               width - 2 * letters.margin),
                letters.margin, 2, faint);
  return band;
}

}  // namespace

Result<void> write_overlay(const std::filesystem::path& file, const FramePair& pair, const Camera& camera,
                           const RigidTransform& T_camera_lidar, const DepthMap* depth, const OverlayCaption* caption) {
  const auto compression = compression_for(file);
  if (!compression)
    return fail(ErrorCode::write_failed, file.string() + " cannot be written: its extension is neither .png nor .jpg");
  try {
    const cv::Mat colours = colour_table();
    cv::Mat picture = points_on_image(pair, camera, T_camera_lidar, colours);
    const int width = picture.cols;
    if (caption != nullptr) cv::vconcat(heading(*caption, width, colours), picture, picture);
    if (depth != nullptr && depth->width == width) {
      if (caption != nullptr) cv::vconcat(picture, depth_heading(width), picture);
      cv::vconcat(picture, depth_in_colours(*depth, colours), picture);
    }
    const auto encoded = encode_pixels({picture.data, picture.total() * picture.elemSize()},
                                       {picture.cols, picture.rows, picture.channels()}, *compression);
    if (!encoded)
      return fail(ErrorCode::write_failed, file.string() + " cannot be written: " + encoded.error().context);
    return replace_file(file, *encoded);
  } catch (const cv::Exception& exception) {
    return fail(ErrorCode::write_failed, file.string() + " cannot be written: " + exception.err);
  }
}

}  // namespace calib
