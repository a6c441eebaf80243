#include "vehicle/camera_option.hpp"

#include <array>
#include <charconv>
#include <optional>
#include <string_view>
#include <vector>

namespace calib::vehicle {
namespace {

/// A lens with a name. Intrinsics at its own size, from which it is scaled.
struct Lens {
  std::string_view name;
  CameraModel model;
  int width, height;  // of `intrinsics`
  int usual_width, usual_height;
  std::array<double, 4> intrinsics;
  std::vector<double> distortion;
};

const std::array lenses{
    Lens{
        "fisheye-double-sphere", CameraModel::double_sphere, 800, 800, 800, 800, {208, 208, 399.5, 399.5}, {-0.2, 0.6}},
    Lens{"kitti-360-fisheye",
         CameraModel::mei,
         1400,
         1400,
         700,
         700,
         {1336.3220825849971, 1335.7883350012958, 716.94323510126321, 705.76498308221585},
         {2.2134047507854890, 0.016798235660113681, 1.6548773243373522, 0.00042223943394772046,
          0.00042462134260997584}}};

template <typename Number>
std::optional<std::vector<Number>> parse_numbers(std::string_view text, char separator) {
  std::vector<Number> numbers;
  while (true) {
    Number number{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc()) return std::nullopt;
    numbers.push_back(number);
    text.remove_prefix(end - text.data());
    if (text.empty()) return numbers;
    if (text.front() != separator) return std::nullopt;
    text.remove_prefix(1);
  }
}

Result<Camera> make_lens(const Lens& lens, int width, int height) {
  const double across = static_cast<double>(width) / lens.width, down = static_cast<double>(height) / lens.height;
  const auto& [fx, fy, cx, cy] = lens.intrinsics;
  // The corner of the image stays where it is, half a pixel beyond the centre of the first one.
  return Camera::make(lens.model, width, height,
                      {fx * across, fy * down, (cx + 0.5) * across - 0.5, (cy + 0.5) * down - 0.5}, lens.distortion);
}

}  // namespace

Result<Camera> parse_camera(const std::string& text, const std::string& size) {
  std::optional<std::vector<int>> sides;
  if (!size.empty()) {
    sides = parse_numbers<int>(size, 'x');
    if (!sides || sides->size() != 2)
      return fail(ErrorCode::bad_camera, "size '" + escape_control(size) + "' is not WxH");
  }
  const auto colon = text.find(':');
  if (colon == std::string::npos) {
    for (const Lens& lens : lenses)
      if (lens.name == text)
        return make_lens(lens, sides ? (*sides)[0] : lens.usual_width, sides ? (*sides)[1] : lens.usual_height);
    return fail(ErrorCode::bad_camera, "'" + escape_control(text) +
                                           "' is neither fisheye-double-sphere, kitti-360-fisheye nor "
                                           "MODEL:fx,fy,cx,cy[,distortion...]");
  }
  const auto model = parse_camera_model(std::string_view(text).substr(0, colon));
  if (!model) return propagate(model);
  const auto numbers = parse_numbers<double>(std::string_view(text).substr(colon + 1), ',');
  if (!numbers || numbers->size() < 4 || !sides)
    return fail(ErrorCode::bad_camera, "a camera is MODEL:fx,fy,cx,cy[,distortion...] and a size WxH");
  return Camera::make(*model, (*sides)[0], (*sides)[1], {numbers->begin(), numbers->begin() + 4},
                      {numbers->begin() + 4, numbers->end()});
}

}  // namespace calib::vehicle
