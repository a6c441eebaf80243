#include "calib/overlay.hpp"

#include <fstream>
#include <opencv2/imgcodecs.hpp>

#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
using test::require_ok;

namespace {

/// A grey image of 64 x 48, a near point in its left half and a far one in its right half.
struct Shot {
  Camera camera = require_ok(Camera::make(CameraModel::rectified, 64, 48, {50, 50, 32, 24}));
  FramePair pair{{{}, 64, 48, std::vector<std::uint8_t>(64 * 48, 100)}, {}, {{}, {{-1, 0, 4, 0}, {20, 0, 80, 0}}}};
};

bool warm(const cv::Vec3b& bgr) { return bgr[2] > bgr[0] + 50; }
bool cold(const cv::Vec3b& bgr) { return bgr[0] > bgr[2] + 20; }

}  // namespace

TEST_CASE("near points are red and far ones blue, where they land") {
  const test::TemporaryFolder folder;
  const Shot shot;
  const auto file = folder.path() / "overlay.png";
  require_ok(write_overlay(file, shot.pair, shot.camera, RigidTransform::Identity()));
  const cv::Mat picture = cv::imread(file.string());
  REQUIRE(picture.size() == cv::Size(64, 48));
  CHECK(warm(picture.at<cv::Vec3b>(24, 20)));
  CHECK(cold(picture.at<cv::Vec3b>(24, 45)));
  CHECK(picture.at<cv::Vec3b>(2, 2) == cv::Vec3b(100, 100, 100));
}

TEST_CASE("an image that is smaller than its camera's gets the dots that it has room for") {
  const test::TemporaryFolder folder;
  Shot shot;
  shot.pair.image = {{}, 16, 12, std::vector<std::uint8_t>(16 * 12, 100)};
  shot.pair.scan.points.push_back({-0.9F, -0.7F, 1.8F, 0});  // lands at 7, 5
  const auto file = folder.path() / "overlay.png";
  require_ok(write_overlay(file, shot.pair, shot.camera, RigidTransform::Identity()));
  const cv::Mat picture = cv::imread(file.string());
  REQUIRE(picture.size() == cv::Size(16, 12));
  CHECK(warm(picture.at<cv::Vec3b>(5, 7)));
}

TEST_CASE("the image is seen between the dots of a dense scan") {
  const test::TemporaryFolder folder;
  Shot shot;
  shot.pair.scan.points.clear();
  for (int v = 0; v < 480; ++v)
    for (int u = 0; u < 640; ++u)
      shot.pair.scan.points.push_back(
          {(static_cast<float>(u) / 10 - 32) / 50, (static_cast<float>(v) / 10 - 24) / 50, 1, 0});
  const auto file = folder.path() / "overlay.png";
  require_ok(write_overlay(file, shot.pair, shot.camera, RigidTransform::Identity()));
  cv::Mat untouched;
  cv::inRange(cv::imread(file.string()), cv::Scalar::all(100), cv::Scalar::all(100), untouched);
  CHECK(cv::countNonZero(untouched) > 64 * 48 / 2);
  CHECK(cv::countNonZero(untouched) < 64 * 48 * 9 / 10);
}

TEST_CASE("depth stands below the image in the same colours, black where there is none") {
  const test::TemporaryFolder folder;
  const Shot shot;
  DepthMap depth{64, 48, std::vector<float>(64 * 48, DepthMap::no_depth)};
  for (int v = 0; v < 48; ++v)
    for (int u = 0; u < 64; ++u)
      if (v > 8) depth.inverse_depth[static_cast<std::size_t>(v) * 64 + u] = static_cast<float>(64 - u);
  const auto file = folder.path() / "overlay.png";
  require_ok(write_overlay(file, shot.pair, shot.camera, RigidTransform::Identity(), &depth));
  const cv::Mat picture = cv::imread(file.string());
  REQUIRE(picture.size() == cv::Size(64, 96));
  CHECK(warm(picture.at<cv::Vec3b>(48 + 30, 4)));
  CHECK(cold(picture.at<cv::Vec3b>(48 + 30, 58)));
  CHECK(picture.at<cv::Vec3b>(48 + 4, 30) == cv::Vec3b(0, 0, 0));
}

TEST_CASE("a caption adds a heading with a legend above the image, and a line above the depth") {
  const test::TemporaryFolder folder;
  const int width = 480, height = 160;
  const Camera camera = require_ok(Camera::make(CameraModel::rectified, width, height, {400, 400, 240, 80}));
  const FramePair pair{{{}, width, height, std::vector<std::uint8_t>(width * height, 100)}, {}, {{}, {{-1, 0, 4, 0}}}};
  const DepthMap depth{width, height, std::vector<float>(width * height, 0.1F)};
  const auto picture_of = [&](const OverlayCaption* caption) {
    const auto file = folder.path() / "overlay.png";
    require_ok(write_overlay(file, pair, camera, RigidTransform::Identity(), &depth, caption));
    return cv::imread(file.string());
  };
  const cv::Mat plain = picture_of(nullptr);
  const OverlayCaption caption{"front: calibrated", {"image /left/image", std::string(500, 'x') + "\xC3\xA4"}};
  const cv::Mat titled = picture_of(&caption);
  REQUIRE(titled.cols == width);
  const int added = titled.rows - plain.rows;
  CHECK((added > 60 && added < 160));
  // What was there is there, in two parts: the image, and the depth at the end.
  CHECK(cv::norm(titled.rowRange(titled.rows - height, titled.rows), plain.rowRange(height, 2 * height)) == 0);
  int at = 0;
  while (at < added && cv::norm(titled.rowRange(at, at + height), plain.rowRange(0, height)) != 0) ++at;
  REQUIRE(at < added);
  CHECK(added - at > 8);
  // The legend goes from near to far, left to right, and the letters are cut at the edge.
  int warmest = -1, coldest = -1;
  for (int v = 0; v < at; ++v)
    for (int u = 0; u < width; ++u) {
      if (warm(titled.at<cv::Vec3b>(v, u)) && warmest < 0) warmest = u;
      if (cold(titled.at<cv::Vec3b>(v, u))) coldest = u;
    }
  CHECK((warmest > 0 && warmest < width / 2));
  CHECK(coldest > width * 3 / 4);
  cv::Mat last;
  cv::inRange(titled(cv::Rect(width - 3, 0, 3, at)), cv::Scalar::all(24), cv::Scalar::all(24), last);
  CHECK(cv::countNonZero(last) == 3 * at);
}

TEST_CASE("the extension chooses PNG or JPEG, in either case") {
  const test::TemporaryFolder folder;
  const Shot shot;
  for (const auto& [name, begin] : {std::pair{"picture.PNG", 0x89}, {"picture.jpg", 0xFF}, {"picture.Jpeg", 0xFF}}) {
    INFO(name);
    const auto file = folder.path() / name;
    require_ok(write_overlay(file, shot.pair, shot.camera, RigidTransform::Identity()));
    CHECK(std::ifstream(file, std::ios::binary).get() == begin);
    const cv::Mat picture = cv::imread(file.string());
    REQUIRE(picture.size() == cv::Size(64, 48));
    CHECK(warm(picture.at<cv::Vec3b>(24, 20)));
    CHECK(cold(picture.at<cv::Vec3b>(24, 45)));
    CHECK(cv::norm(picture.at<cv::Vec3b>(2, 2), cv::Vec3b(100, 100, 100)) < 4);
  }
}

TEST_CASE("a picture takes the place of a symbolic link, and leaves alone what that points to") {
  const test::TemporaryFolder folder;
  const Shot shot;
  std::ofstream(folder.path() / "target") << "untouched";
  std::filesystem::create_symlink("target", folder.path() / "picture.png");
  require_ok(write_overlay(folder.path() / "picture.png", shot.pair, shot.camera, RigidTransform::Identity()));
  CHECK(std::filesystem::file_size(folder.path() / "target") == 9);
  CHECK_FALSE(std::filesystem::is_symlink(folder.path() / "picture.png"));
}

TEST_CASE("a picture that cannot be written is an error that names it") {
  const test::TemporaryFolder folder;
  const Shot shot;
  for (const char* name : {"no/such/folder.png", "picture.nothing", "picture.bmp", "picture"}) {
    const auto written = write_overlay(folder.path() / name, shot.pair, shot.camera, RigidTransform::Identity());
    REQUIRE_FALSE(written);
    CHECK(written.error().code == "write_failed");
    CHECK(written.error().context.find(name) != std::string::npos);
  }
}
