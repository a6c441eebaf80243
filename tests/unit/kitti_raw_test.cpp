#include <fstream>

#include "calib/extrinsic_check.hpp"
#include "dataset/kitti_raw_writer.hpp"
#include "dataset/recording.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
namespace fs = std::filesystem;

namespace {

/// A drive of two small frames in a folder of its own.
struct WrittenDrive {
  WrittenDrive() {
    auto writer = KittiRawWriter::create(drive, camera, 0.54, T_camera_lidar);
    REQUIRE(writer);
    for (int i = 0; i < 2; ++i) REQUIRE(writer->append(pair(i)));
  }

  FramePair pair(int index) const {
    FramePair result;
    result.image = {.width = 32, .height = 16, .pixels = std::vector<std::uint8_t>(32 * 16)};
    for (std::size_t i = 0; i < result.image.pixels.size(); ++i) result.image.pixels[i] = (7 * i + 50 * index) % 256;
    result.right_image = result.image;
    result.right_image->pixels[5] = 200;
    result.scan.points = {{1.5f, -2.f, 0.25f, 0.5f}, {10.f + static_cast<float>(index), 3.f, -1.f, 0.f}};
    return result;
  }

  Camera camera = Camera::make(CameraModel::rectified, 32, 16, {20, 21, 15.5, 7.25}).value();
  RigidTransform T_camera_lidar = make_transform({0.01, -0.08, -0.27}, {0.5, -0.5, 0.5, -0.5}).value();
  test::TemporaryFolder root;
  fs::path drive = root.path() / "2026_01_01/2026_01_01_drive_0001_sync";
};

void write_file(const fs::path& path, const std::string& bytes) { std::ofstream(path, std::ios::binary) << bytes; }

}  // namespace

TEST_CASE("a written drive reads back as it was") {
  const WrittenDrive written;
  const auto drive = open_kitti_raw(written.drive);
  REQUIRE(drive);
  REQUIRE(drive->size() == 2);
  CHECK(drive->camera().width() == 32);
  CHECK(drive->camera().height() == 16);
  CHECK(drive->camera().fx() == 20);
  CHECK(drive->camera().cy() == 7.25);
  CHECK(*drive->baseline_m() == Approx(0.54).epsilon(1e-12));
  CHECK(drive->T_camera_lidar().isApprox(written.T_camera_lidar, 1e-9));
  for (int i = 0; i < 2; ++i) {
    const auto frame = drive->frame(i);
    REQUIRE(frame);
    CHECK(frame->image.pixels == written.pair(i).image.pixels);
    CHECK(frame->right_image->pixels == written.pair(i).right_image->pixels);
    REQUIRE(frame->scan.points.size() == 2);
    CHECK(frame->scan.points[1].x_m == Approx(10 + i));
    CHECK(frame->scan.points[0].reflectance == 0.5f);
    CHECK(frame->image.stamp == std::chrono::milliseconds(100 * i));
    CHECK(frame->time_difference().count() == 0);
  }
  CHECK(drive->frame(2).error().code == "frame_out_of_range");
  CHECK(open_kitti_raw(written.drive.string() + "/"));
}

TEST_CASE("the fourth column of P_rect_02 and R_rect_00 are part of the extrinsic") {
  const WrittenDrive written;
  // P = K [I | t] with t = (0.06, 0.003, 0.002); R_rect_00 turns a quarter about z.
  write_file(written.drive.parent_path() / "calib_cam_to_cam.txt",
             "calib_time: 01-Jan-2026 00:00:00\nS_rect_02: 32 16\nR_rect_00: 0 -1 0 1 0 0 0 0 1\n"
             "P_rect_02: 20 0 15.5 1.231 0 21 7.25 0.0775 0 0 1 0.002\n"
             "P_rect_03: 20 0 15.5 -9.569 0 21 7.25 0.0775 0 0 1 0.002\n");
  write_file(written.drive.parent_path() / "calib_velo_to_cam.txt", "R: 1 0 0 0 1 0 0 0 1\nT: 1 2 3\n");
  const auto drive = open_kitti_raw(written.drive);
  REQUIRE(drive);
  CHECK(*drive->baseline_m() == Approx(0.54));
  const Eigen::Vector3d origin = drive->T_camera_lidar() * Eigen::Vector3d::Zero();
  CHECK(origin.isApprox(Eigen::Vector3d(-2 + 0.06, 1 + 0.003, 3 + 0.002), 1e-9));
}

TEST_CASE("a drive without a right camera opens without stereo, and so does the right camera alone") {
  const WrittenDrive written;
  CHECK(open_kitti_raw(written.drive)->has_stereo());
  const auto right = open_kitti_raw(written.drive, "image_03");
  REQUIRE(right);
  CHECK_FALSE(right->has_stereo());
  // The right camera is a baseline to the right of the left one.
  CHECK((right->T_camera_lidar().translation() - written.T_camera_lidar.translation())
            .isApprox(Eigen::Vector3d(-0.54, 0, 0), 1e-9));
  CHECK(right->frame(0)->image.pixels[5] == 200);

  fs::remove_all(written.drive / "image_03");
  const auto left = open_kitti_raw(written.drive);
  REQUIRE(left);
  CHECK_FALSE(left->has_stereo());
  CHECK(*left->baseline_m() == Approx(0.54));  // as the calibration still says: disparities become metres by it
  CHECK_FALSE(left->frame(1)->right_image);
}

TEST_CASE("a drive that is not whole says what is wrong") {
  const WrittenDrive written;
  const fs::path date = written.drive.parent_path();
  CHECK(open_kitti_raw(written.root.path() / "nowhere").error().code == "recording_not_found");

  SECTION("a calibration file is missing") {
    fs::remove(date / "calib_velo_to_cam.txt");
    const auto drive = open_kitti_raw(written.drive);
    REQUIRE_FALSE(drive);
    CHECK(drive.error().code == "calibration_missing");
    CHECK(drive.error().context.find("calib_velo_to_cam.txt") != std::string::npos);
  }
  SECTION("a matrix is short, not finite or no rotation") {
    for (const char* text : {"R: 1 0 0 0 1 0 0 0\nT: 0 0 0\n", "R: 1 0 0 0 1 0 0 0 nan\nT: 0 0 0\n",
                             "R: 1 0 0 0 1 0 0 0 2\nT: 0 0 0\n", "R: 1 0 0 0 1 0 0 0 -1\nT: 0 0 0\n", ""}) {
      write_file(date / "calib_velo_to_cam.txt", text);
      const auto drive = open_kitti_raw(written.drive);
      REQUIRE_FALSE(drive);
      CHECK(drive.error().code == "calibration_malformed");
    }
  }
  SECTION("a scan is missing: the frames that have one are read") {
    fs::remove(written.drive / "velodyne_points/data/0000000000.bin");
    const auto drive = open_kitti_raw(written.drive);
    REQUIRE(drive);
    REQUIRE(drive->size() == 1);
    CHECK(drive->frame_name(0) == "0000000001");
    CHECK(drive->frame(0)->scan.points[1].x_m == 11);
  }
  SECTION("images and scans that do not pair: counts and first names are given") {
    fs::rename(written.drive / "velodyne_points/data/0000000000.bin", written.drive / "velodyne_points/data/7.bin");
    fs::rename(written.drive / "velodyne_points/data/0000000001.bin", written.drive / "velodyne_points/data/8.bin");
    const auto drive = open_kitti_raw(written.drive);
    REQUIRE_FALSE(drive);
    CHECK(drive.error().code == "frame_mismatch");
    for (const char* part : {"only 0 frames", "2 in ", "(first: 0000000000)", "(first: 7)"})
      CHECK(drive.error().context.find(part) != std::string::npos);
  }
  SECTION("there is no folder of scans, or no such camera") {
    CHECK(open_kitti_raw(written.drive, "image_04").error().code == "recording_not_found");
    fs::remove_all(written.drive / "velodyne_points");
    CHECK(open_kitti_raw(written.drive).error().code == "recording_not_found");
  }
  SECTION("a scan is empty or cut off, an image is no image or of another size") {
    const auto drive = open_kitti_raw(written.drive);
    REQUIRE(drive);
    write_file(written.drive / "velodyne_points/data/0000000000.bin", "");
    CHECK(drive->frame(0).error().code == "cloud_empty");
    write_file(written.drive / "velodyne_points/data/0000000000.bin", "12345678901234567");
    CHECK(drive->frame(0).error().code == "cloud_unreadable");
    write_file(written.drive / "image_03/data/0000000001.png", "not a picture");
    CHECK(drive->frame(1).error().code == "image_unreadable");
  }
}

TEST_CASE("a recorded drive's extrinsic puts most of the points ahead into the image") {
  const auto folder = test::kitti_drive();
  if (!folder) return test::skip("set CALIB_KITTI_DRIVE to a <date>/<drive> folder of KITTI raw");
  const auto drive = open_kitti_raw(*folder);
  REQUIRE(drive);
  REQUIRE(drive->size() > 0);
  CHECK(*drive->baseline_m() == Approx(0.54).margin(0.02));
  for (const std::size_t index : {std::size_t{0}, drive->size() - 1}) {
    const auto frame = drive->frame(index);
    REQUIRE(frame);
    REQUIRE(frame->scan.points.size() > 10'000);
    int ahead = 0, seen = 0;
    for (const LidarPoint& point : frame->scan.points) {
      if (point.x_m < 8 || std::abs(point.y_m) > 0.6 * point.x_m) continue;
      ++ahead;
      const Eigen::Vector3d p_lidar(point.x_m, point.y_m, point.z_m);
      seen += drive->camera().project(drive->T_camera_lidar() * p_lidar).has_value();
    }
    REQUIRE(ahead > 1000);
    CHECK(seen > 0.9 * ahead);
    CHECK(check_extrinsic(drive->camera(), drive->T_camera_lidar(), frame->scan));
    const auto inverse = check_extrinsic(drive->camera(), drive->T_camera_lidar().inverse(), frame->scan);
    REQUIRE_FALSE(inverse);
    CHECK(inverse.error().context.find("looks like the inverse") != std::string::npos);
  }
}
