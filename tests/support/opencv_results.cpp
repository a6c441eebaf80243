// Prints a digest of what each function of OpenCV that calibd uses makes of the same images, bit for bit. Built with
// OpenCV's archives and with its shared libraries, for unit/opencv_alone_test.py.

#include <cstdint>
#include <iostream>
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>
#include <string>

namespace {

void print(const std::string& name, const cv::Mat& result) {
  std::uint64_t digest = 14695981039346656037u;  // FNV-1a
  for (int row = 0; row < result.rows; ++row)
    for (std::size_t i = 0; i < result.cols * result.elemSize(); ++i)
      digest = (digest ^ result.ptr(row)[i]) * 1099511628211u;
  std::cout << name << ": " << result.cols << " x " << result.rows << ' ' << std::hex << digest << std::dec << '\n';
}

/// Waves and noise, displaced to the left by `shift` pixels.
cv::Mat picture(int channels, int shift) {
  cv::Mat image(375, 1242, CV_8UC(channels));
  for (int v = 0; v < image.rows; ++v)
    for (int i = 0; i < image.cols * channels; ++i) {
      const auto u = static_cast<std::uint32_t>(i / channels + shift);
      const std::uint32_t noise = (u * 2654435761u) ^ (static_cast<std::uint32_t>(v) * 40503u) ^ (i % channels * 977u);
      image.ptr(v)[i] = static_cast<std::uint8_t>((noise * 2246822519u >> 26) + u % 97 + v % 61);
    }
  return image;
}

void print_colours() {
  const cv::Mat grey = picture(1, 0), two = picture(2, 0), three = picture(3, 0), four = picture(4, 0);
  const cv::Mat planes = grey(cv::Rect(0, 0, 1242, 372));  // 3/2 of an image's height
  const auto convert = [](const char* name, const cv::Mat& image, int code) {
    cv::Mat result;
    cv::cvtColor(image, result, code);
    print(name, result);
  };
  convert("grey of RGB", three, cv::COLOR_RGB2GRAY);
  convert("grey of BGR", three, cv::COLOR_BGR2GRAY);
  convert("RGB of BGR", three, cv::COLOR_BGR2RGB);
  convert("RGB of grey", grey, cv::COLOR_GRAY2RGB);
  convert("grey of BGRA", four, cv::COLOR_BGRA2GRAY);
  convert("RGB of BGRA", four, cv::COLOR_BGRA2RGB);
  convert("grey of a Bayer pattern", grey, cv::COLOR_BayerBG2GRAY);
  convert("RGB of a Bayer pattern", grey, cv::COLOR_BayerGR2RGB);
  convert("grey of UYVY", two, cv::COLOR_YUV2GRAY_UYVY);
  convert("RGB of YUYV", two, cv::COLOR_YUV2RGB_YUY2);
  convert("RGB of NV12", planes, cv::COLOR_YUV2RGB_NV12);
  convert("RGB of I420", planes, cv::COLOR_YUV2RGB_I420);
}

void print_geometry() {
  const cv::Mat grey = picture(1, 0), colour = picture(3, 0);
  cv::Mat map(grey.size(), CV_32FC2), fixed, fractions, result, floats;
  for (int v = 0; v < map.rows; ++v)
    for (int u = 0; u < map.cols; ++u)
      map.at<cv::Vec2f>(v, u) = {static_cast<float>(u + 3.3 - 1e-5 * u * v),
                                 static_cast<float>(v - 2.7 + 2e-5 * u * u)};
  cv::convertMaps(map, cv::noArray(), fixed, fractions, CV_16SC2);
  print("fixed-point map", fixed);
  print("its fractions", fractions);
  cv::remap(grey, result, fixed, fractions, cv::INTER_LINEAR);
  print("rectified image", result);
  grey.convertTo(floats, CV_32F, 1 / 255.0);
  for (const int how : {cv::INTER_NEAREST, cv::INTER_LINEAR, cv::INTER_CUBIC, cv::INTER_AREA, cv::INTER_LANCZOS4})
    for (const cv::Mat& image : {grey, colour, floats}) {
      cv::resize(image, result, {621, 187}, 0, 0, how);
      print("smaller image", result);
      cv::resize(image, result, {1300, 390}, 0, 0, how);
      print("larger image", result);
    }
}

void print_depth() {
  const cv::Mat left = picture(1, 0), right = picture(1, 21);
  cv::Mat result;
  cv::StereoSGBM::create(0, 64, 5, 8 * 25, 32 * 25, 1, 31, 10, 100, 2, cv::StereoSGBM::MODE_SGBM)
      ->compute(left, right, result);
  print("semi-global matching", result);
  cv::StereoSGBM::create(0, 64, 5, 8 * 25, 32 * 25, 1, 31, 10, 100, 2, cv::StereoSGBM::MODE_SGBM_3WAY)
      ->compute(left, right, result);
  print("semi-global matching, three ways", result);
  cv::StereoBM::create(64, 15)->compute(left, right, result);
  print("block matching", result);
}

void print_drawing() {
  cv::Mat image, both;
  cv::applyColorMap(picture(1, 0), image, cv::COLORMAP_TURBO);
  cv::line(image, {3, 5}, {800, 300}, {255, 0, 0}, 2, cv::LINE_AA);
  cv::circle(image, {100, 100}, 30, {0, 255, 0}, cv::FILLED, cv::LINE_AA);
  cv::putText(image, "22.5 m", {200, 200}, cv::FONT_HERSHEY_SIMPLEX, 0.7, {255, 255, 255}, 1, cv::LINE_AA);
  cv::vconcat(image, image, both);
  print("drawing", both);
}

}  // namespace

int main() {
  cv::setNumThreads(1);
  print_colours();
  print_geometry();
  print_depth();
  print_drawing();
}
