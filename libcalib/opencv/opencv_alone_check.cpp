// Whether OpenCV's archives, with opencv_alone.cpp, have all that calibd takes of them.
#include <opencv2/calib3d.hpp>
#include <opencv2/imgproc.hpp>

int main(int count, char**) {
  cv::Mat image(count, count, CV_8UC3, cv::Scalar(1, 2, 3)), grey, map1, map2, small;
  const cv::Mat map(count, count, CV_32FC2);
  cv::setNumThreads(1);
  cv::cvtColor(image, grey, cv::COLOR_RGB2GRAY);
  cv::convertMaps(map, cv::noArray(), map1, map2, CV_16SC2);
  cv::remap(grey, small, map1, map2, cv::INTER_LINEAR);
  cv::resize(grey, small, {count, count}, 0, 0, cv::INTER_AREA);
  cv::StereoSGBM::create()->compute(grey, grey, small);
  cv::StereoBM::create()->compute(grey, grey, small);
  cv::applyColorMap(grey, image, cv::COLORMAP_JET);
  cv::line(image, {0, 0}, {1, 1}, 0);
  cv::circle(image, {0, 0}, 1, 0, cv::FILLED);
  cv::putText(image, "a", {0, 0}, cv::FONT_HERSHEY_SIMPLEX, 1, 0, 1, cv::LINE_AA);
  return static_cast<int>((image * 2).size().area() + image.total());
}
