#include "dataset/recording.hpp"

#include <sys/stat.h>

#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iomanip>
#include <sstream>

#include "dataset/cloud_file.hpp"
#include "dataset/image_file.hpp"
#include "dataset/list_writer.hpp"
#include "support/catch.hpp"
#include "support/support.hpp"

using namespace calib;
namespace fs = std::filesystem;

namespace {

void write_file(const fs::path& path, const std::string& bytes) {
  fs::create_directories(path.parent_path());
  std::ofstream(path, std::ios::binary) << bytes;
}

/// A 32 x 16 image whose first pixel tells which it is.
Image image_of(int grey) {
  Image image{{}, 32, 16, std::vector<std::uint8_t>(32 * 16, 100)};
  image.pixels[0] = static_cast<std::uint8_t>(grey);
  return image;
}

void write_frame(const fs::path& image, const fs::path& cloud, int mark) {
  fs::create_directories(image.parent_path());
  fs::create_directories(cloud.parent_path());
  test::require_ok(write_image(image, image_of(mark)));
  test::require_ok(write_cloud(cloud, {{}, {{static_cast<float>(mark), 1, 2, 0.5f}}}));
}

std::string numbers(const Eigen::MatrixXd& matrix) {
  std::ostringstream out;
  out << std::setprecision(17);
  for (int row = 0; row < matrix.rows(); ++row)
    for (int column = 0; column < matrix.cols(); ++column) out << ' ' << matrix(row, column);
  return out.str();
}

RigidTransform motion(double roll, double pitch, double yaw, double x, double y, double z) {
  Vector6 delta;
  delta << roll, pitch, yaw, x, y, z;
  return perturbation(delta);
}

bool mentions(const Error& error, const char* text) { return error.context.find(text) != std::string::npos; }

/// Three images and three scans of which two go together, and the calibration of all four cameras.
struct Kitti360 {
  Kitti360() {
    write_file(calibration / "perspective.txt",
               "S_rect_00: 32 16\nR_rect_00:" + numbers(R_rect_00.linear()) +
                   "\nP_rect_00: 20 0 15.5 0 0 21 7.25 0 0 0 1 0\nS_rect_01: 32 16\nR_rect_01: 1 0 0 0 1 0 0 0 1\n"
                   "P_rect_01: 20 0 15.5 -12 0 21 7.25 0 0 0 1 0\n");
    write_file(calibration / "calib_cam_to_velo.txt", numbers(T_lidar_camera0.matrix().topRows<3>()) + "\n");
    write_file(calibration / "calib_cam_to_pose.txt",
               "image_00:" + numbers(T_pose_camera0.matrix().topRows<3>()) +
                   "\nimage_01:" + numbers(T_pose_camera1.matrix().topRows<3>()) +
                   "\nimage_02:" + numbers(T_pose_camera2.matrix().topRows<3>()) + "\n");
    write_file(calibration / "image_02.yaml",
               "%YAML:1.0\n---\nmodel_type: MEI\ncamera_name: image_02\nimage_width: 32\nimage_height: 16\n"
               "mirror_parameters:\n   xi: 2.2\ndistortion_parameters:\n   k1: 1.6e-02\n   k2: 1.6\n   p1: 4e-04\n"
               "   p2: 5e-04\nprojection_parameters:\n   gamma1: 30\n   gamma2: 31\n   u0: 15.5\n   v0: 7.5\n");
    for (const char* images : {"image_00/data_rect", "image_01/data_rect", "image_02/data_rgb"})
      for (int i = 1; i <= 3; ++i)
        write_frame(root / "data_2d_raw/drive" / images / ("000000000" + std::to_string(i) + ".png"),
                    root / "data_3d_raw/drive/velodyne_points/data" / ("000000000" + std::to_string(i + 1) + ".bin"),
                    i);
  }
  test::TemporaryFolder folder;
  fs::path root = folder.path(), calibration = root / "calibration";
  RigidTransform R_rect_00 = motion(0.01, -0.02, 0.03, 0, 0, 0);
  RigidTransform T_lidar_camera0 = motion(-1.5, 0.1, -1.6, 0.8, 0.3, -0.2);
  RigidTransform T_pose_camera0 = motion(1.4, 0.1, 0.2, 1.5, 0, 1), T_pose_camera1 = motion(1.4, 0.1, 0.2, 1.5, 0.6, 1),
                 T_pose_camera2 = motion(1.5, 0.2, 1.6, 1, 0.5, 1.1);
};

const char* const list_head =
    "camera: {model: plumb_bob, size: [32, 16], intrinsics: [20, 21, 15.5, 7.25], distortion: [0.1, 0, 0, 0]}\n"
    "T_camera_lidar: {translation_m: [0.1, 0.2, 0.3], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}\n";

}  // namespace

TEST_CASE("KITTI-360: the perspective camera is rectified, and frames are those with image and scan") {
  const Kitti360 data;
  const auto recording = test::require_ok(open_kitti_360(data.root, "drive"));
  REQUIRE(recording.size() == 2);
  CHECK(recording.frame_name(0) == "0000000002");
  CHECK(recording.lacks() == std::vector<std::string>{"no cloud for 0000000001", "no image for 0000000004"});
  CHECK(recording.camera().model() == CameraModel::rectified);
  CHECK(recording.camera().fy() == 21);
  CHECK(*recording.baseline_m() == Approx(0.6));
  CHECK(recording.has_stereo());
  // calib_cam_to_velo is camera to LiDAR, the inverse of KITTI's.
  CHECK(recording.T_camera_lidar().isApprox(data.R_rect_00 * data.T_lidar_camera0.inverse(), 1e-9));
  const auto pair = test::require_ok(recording.frame(1));
  CHECK(pair.image.pixels[0] == 3);
  CHECK(pair.right_image->pixels[0] == 3);
  CHECK(pair.scan.points.at(0).x_m == 2);
}

TEST_CASE("KITTI-360: the second camera and the fisheye stand where their poses say") {
  const Kitti360 data;
  const auto T_camera0_lidar = data.T_lidar_camera0.inverse();
  const auto second = test::require_ok(open_kitti_360(data.root, "drive", "image_01"));
  CHECK(second.T_camera_lidar().isApprox(data.T_pose_camera1.inverse() * data.T_pose_camera0 * T_camera0_lidar, 1e-9));
  CHECK_FALSE(second.has_stereo());

  const auto fisheye = test::require_ok(open_kitti_360(data.root, "drive", "image_02"));
  CHECK(fisheye.T_camera_lidar().isApprox(data.T_pose_camera2.inverse() * data.T_pose_camera0 * T_camera0_lidar, 1e-9));
  CHECK(fisheye.camera().model() == CameraModel::mei);
  CHECK(fisheye.camera().fx() == 30);
  CHECK(fisheye.camera().cy() == 7.5);
  CHECK(fisheye.camera().distortion() == std::vector<double>{2.2, 0.016, 1.6, 4e-4, 5e-4});
  CHECK_FALSE(fisheye.has_stereo());
  CHECK(fisheye.frame(0)->image.pixels[0] == 2);
}

TEST_CASE("KITTI-360: what is missing or broken is named") {
  const Kitti360 data;
  CHECK(open_kitti_360(data.root, "drive", "image_05").error().code == "recording_not_found");
  CHECK(open_kitti_360(data.root, "no_drive").error().code == "recording_not_found");
  for (const auto& [file, camera] : {std::pair{"perspective.txt", "image_01"},
                                     {"image_02.yaml", "image_02"},
                                     {"calib_cam_to_pose.txt", "image_02"},
                                     {"calib_cam_to_velo.txt", "image_00"}}) {
    INFO(file);
    write_file(data.calibration / file, "%YAML:1.0\n---\nxi: 1\n");
    const auto broken = open_kitti_360(data.root, "drive", camera);
    REQUIRE_FALSE(broken);
    CHECK(broken.error().code == "calibration_malformed");
    CHECK(mentions(broken.error(), file));
    fs::remove(data.calibration / file);
    const auto missing = open_kitti_360(data.root, "drive", camera);
    REQUIRE_FALSE(missing);
    CHECK(missing.error().code == "calibration_missing");
    CHECK(mentions(missing.error(), file));
  }
}

TEST_CASE("a list names its frames one by one, relative to itself") {
  const test::TemporaryFolder folder;
  const fs::path yaml = folder.path() / "here/list.yaml";
  write_frame(folder.path() / "a/x.png", folder.path() / "here/c1.bin", 1);
  write_frame(folder.path() / "a/y.png", folder.path() / "here/c2.bin", 2);
  write_file(yaml, std::string(list_head) +
                       "baseline_m: 0.4\nframes:\n  - {image: ../a/y.png, right_image: ../a/x.png, cloud: c2.bin}\n");
  const auto recording = test::require_ok(open_list(yaml));
  REQUIRE(recording.size() == 1);
  CHECK(recording.frame_name(0) == "y");
  CHECK(recording.has_stereo());
  CHECK(recording.camera().distortion().at(0) == 0.1);
  CHECK(translation_m(recording.T_camera_lidar()) == std::array{0.1, 0.2, 0.3});
  const auto pair = test::require_ok(recording.frame(0));
  CHECK(pair.image.pixels[0] == 2);
  CHECK(pair.right_image->pixels[0] == 1);
  CHECK(pair.scan.points.at(0).x_m == 2);
}

TEST_CASE("extensions are read in either case") {
  const test::TemporaryFolder folder;
  write_frame(folder.path() / "images/0.png", folder.path() / "clouds/0.bin", 1);
  fs::rename(folder.path() / "images/0.png", folder.path() / "images/0.PNG");
  fs::rename(folder.path() / "clouds/0.bin", folder.path() / "clouds/0.BIN");
  write_file(folder.path() / "list.yaml", std::string(list_head) + "images: images\nclouds: clouds\n");
  const auto recording = test::require_ok(open_list(folder.path() / "list.yaml"));
  REQUIRE(recording.size() == 1);
  CHECK(test::require_ok(recording.frame(0)).scan.points.at(0).x_m == 1);
}

TEST_CASE("a list says how its clouds are written, and who opens it may say otherwise") {
  const test::TemporaryFolder folder;
  const fs::path yaml = folder.path() / "list.yaml";
  write_frame(folder.path() / "a.png", folder.path() / "a.bin", 1);
  const float points[] = {1, 2, 3, 9, 31, 4, 5, 6, 8, 30};
  write_file(folder.path() / "a.bin", {reinterpret_cast<const char*>(points), sizeof points});
  const std::string frame = "frames: [{image: a.png, cloud: a.bin}]\n";
  write_file(yaml, std::string(list_head) + "cloud_layout: float32x5\n" + frame);
  auto recording = test::require_ok(open_list(yaml));
  CHECK(test::require_ok(recording.frame(0)).scan.points.at(1).reflectance == 8);
  recording.set_cloud_layout({});
  CHECK(recording.frame(0).error().code == "cloud_unreadable");
  for (const char* wrong : {"xyzi", "[1, 2]", "4"}) {
    write_file(yaml, std::string(list_head) + "cloud_layout: " + wrong + "\n" + frame);
    CHECK(open_list(yaml).error().code == "calibration_malformed");
  }
  CHECK(mentions(open_list(yaml).error(), "list.yaml:3: '4' is no layout of a cloud; write float32x4"));
}

TEST_CASE("a list names folders whose files go together by name") {
  const test::TemporaryFolder folder;
  for (int i = 0; i < 3; ++i)
    write_frame(folder.path() / "images" / (std::to_string(i) + ".png"),
                folder.path() / "clouds" / (std::to_string(i) + ".bin"), i);
  fs::remove(folder.path() / "clouds/1.bin");
  write_file(
      folder.path() / "list.yaml",
      "camera: {model: rectified, size: [32, 16], intrinsics: [20, 21, 15.5, 7.25]}\nT_camera_lidar:\n  matrix:\n"
      "    - [0, -1, 0, 0.1]\n    - [0, 0, -1, 0.2]\n    - [1, 0, 0, 0.3]\nimages: images\nclouds: clouds\n");
  const auto recording = test::require_ok(open_list(folder.path() / "list.yaml"));
  REQUIRE(recording.size() == 2);
  CHECK(recording.frame_name(1) == "2");
  CHECK_FALSE(recording.has_stereo());
  CHECK((recording.T_camera_lidar() * Eigen::Vector3d(10, 2, 1)).isApprox(Eigen::Vector3d(-1.9, -0.8, 10.3), 1e-12));
  CHECK(recording.frame(7).error().code == "frame_out_of_range");

  SECTION("an image of another size than the camera's") {
    test::require_ok(write_image(folder.path() / "images/0.png", {{}, 30, 16, std::vector<std::uint8_t>(480)}));
    const auto frame = recording.frame(0);
    REQUIRE_FALSE(frame);
    CHECK(frame.error().code == "image_unreadable");
    CHECK(mentions(frame.error(), "is 30 x 16 pixels, its calibration says 32 x 16"));
  }
  SECTION("images and clouds that do not pair") {
    fs::rename(folder.path() / "clouds/0.bin", folder.path() / "clouds/frame0.bin");
    fs::rename(folder.path() / "clouds/2.bin", folder.path() / "clouds/frame2.bin");
    const auto error = open_list(folder.path() / "list.yaml").error();
    CHECK(error.code == "frame_mismatch");
    CHECK(mentions(error, "only 0 frames"));
    CHECK(mentions(error, "(first: 0)"));
    CHECK(mentions(error, "(first: frame0)"));
  }
}

TEST_CASE("a list that is wrong says where and what") {
  const test::TemporaryFolder folder;
  const fs::path yaml = folder.path() / "list.yaml";
  const std::string head = list_head, frame = "frames: [{image: a.png, cloud: a.bin}]\n";
  struct Case {
    std::string text;
    const char *code, *part;
  };
  for (const auto& [text, code, part] : {
           Case{head + frame + "intrinsics: 3\n", "calibration_malformed",
                "list.yaml:4: a recording has no key 'intrinsics'"},
           Case{head, "calibration_malformed", "frames (or images and clouds) are missing"},
           Case{head + "images: images\n", "calibration_malformed", "clouds is missing"},
           Case{head + "frames: [{image: a.png}]\n", "calibration_malformed", "cloud is missing"},
           Case{head + "frames: [{image: a.png, cloud: 1.bin}, {image: b/a.png, cloud: 2.bin}]\n",
                "calibration_malformed", "two frames have images named a"},
           Case{head + "frames: []\n", "calibration_malformed", "frames is not a list"},
           Case{head + frame + "images: images\n", "calibration_malformed", "both frames and folders"},
           Case{head + "baseline_m: wide\n" + frame, "calibration_malformed", "baseline_m is not a number"},
           Case{head + "baseline_m: -1\n" + frame, "calibration_malformed", "baseline_m is not within"},
           Case{head + head + frame, "calibration_malformed", "has the key 'camera' twice"},
           Case{frame, "calibration_malformed", "camera is missing"},
           Case{"[1, 2", "calibration_malformed", "list.yaml:"},
           Case{"", "calibration_malformed", "list.yaml: the file is empty"},
           Case{"3", "calibration_malformed", "list.yaml:1: a recording is not a map"},
           Case{"camera: {model: pinhole, size: [32, 16], intrinsics: [1, 2, 3, 4]}\nT_camera_lidar: {}\n" + frame,
                "bad_camera", "list.yaml: camera model 'pinhole'"},
           Case{"camera: {model: rectified, size: [32], intrinsics: [20, 20, 3, 4]}\nT_camera_lidar: {}\n" + frame,
                "calibration_malformed", "size is not [width, height]"},
           Case{"camera: {model: rectified, size: [32, 16], intrinsics: [20, 20, 3, 4], bits: 17}\nT_camera_lidar:\n"
                "  {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}\n" +
                    frame,
                "calibration_malformed", "list.yaml:1: bits is not within 8 .. 16"},
           Case{"camera: {model: rectified, size: [32, 16], intrinsics: [20, 20, 3, 4]}\nT_camera_lidar: {matrix: "
                "[[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}\n" +
                    frame,
                "bad_transform", "not a rotation"},
       }) {
    INFO(text);
    write_file(yaml, text);
    const auto recording = open_list(yaml);
    REQUIRE_FALSE(recording);
    INFO(recording.error().context);
    CHECK(recording.error().code == code);
    CHECK(mentions(recording.error(), part));
  }
  CHECK(open_list(folder.path() / "none.yaml").error().code == "recording_not_found");
  const auto is_folder = open_list(folder.path()).error();
  CHECK(is_folder.code == "recording_not_found");
  CHECK(mentions(is_folder, "is a folder"));
  write_file(folder.path() / "recording.yaml", head);
  CHECK(mentions(open_list(folder.path()).error(), (folder.path() / "recording.yaml").c_str()));
}

TEST_CASE("a calibration that is no regular file, is too large or nests without end harms nobody") {
  const Kitti360 data;
  const auto replace = [&](const char* name, const char* camera, const std::string& text) {
    write_file(data.calibration / name, text);
    return open_kitti_360(data.root, "drive", camera).error();
  };
  const std::string deep(500'000, '[');
  CHECK(replace("image_02.yaml", "image_02", deep).code == "calibration_malformed");
  CHECK(replace("image_02.yaml", "image_02", "%YAML:1.0\n---\nimage_width: " + deep).code == "calibration_malformed");
  CHECK(replace("image_02.yaml", "image_02", "a: &a [*a, *a]\nimage_width: *a\n").code == "calibration_malformed");
  CHECK(mentions(replace("image_02.yaml", "image_02", std::string((1 << 20) + 1, '#')), "is larger than 1 MiB"));
  CHECK(mentions(replace("perspective.txt", "image_00", std::string((1 << 20) + 1, '1')), "is larger than 1 MiB"));
  CHECK(replace("perspective.txt", "image_00", std::string(1 << 20, '1')).code == "calibration_malformed");
  for (const auto& [name, camera] : {std::pair{"image_02.yaml", "image_02"}, {"perspective.txt", "image_00"}}) {
    fs::remove(data.calibration / name);
    REQUIRE(mkfifo((data.calibration / name).c_str(), 0600) == 0);
    const auto error = open_kitti_360(data.root, "drive", camera).error();
    CHECK(error.code == "calibration_missing");
    CHECK(mentions(error, "it is a FIFO"));
  }
  const fs::path list = data.root / "list.yaml";
  write_file(list, "frames: " + deep);
  CHECK(open_list(list).error().code == "calibration_malformed");
  fs::resize_file(list, (2 << 20) + 1);
  CHECK(mentions(open_list(list).error(), "is larger than 2 MiB"));
}

TEST_CASE("an image is refused by its header before it is decoded, and where it is damaged") {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "a.pgm";
  write_file(path, "P5 30000 30000 255\n");
  CHECK(mentions(read_image(path).error(), "a.pgm is 30000 x 30000 pixels in 1 scans; up to 64 Mpx"));
  write_file(path, "P5 4000 4000 255\n");
  CHECK(mentions(read_image(path, Colours::grey, std::pair(32, 16)).error(),
                 "is 4000 x 4000 pixels, its calibration says 32 x 16"));
  write_file(path, "GIF89a");
  CHECK(mentions(read_image(path).error(), "a.pgm is not an image (PNG,"));
  CHECK(read_image(folder.path()).error().code == "image_unreadable");
}

TEST_CASE("the example of a list is one, whose camera looks ahead and stands upright") {
  const char* const source = std::getenv("CALIBD_SOURCE_DIR");
  REQUIRE(source != nullptr);
  std::ostringstream readme;
  readme << std::ifstream(fs::path(source) / "tools/dataset/README.md").rdbuf();
  const std::string text = readme.str(), fence = "```";
  const std::size_t begin = text.find(fence + "yaml\n") + 8;
  const test::TemporaryFolder folder;
  write_file(folder.path() / "list.yaml", text.substr(begin, text.find(fence, begin) - begin));
  write_frame(folder.path() / "images/0.png", folder.path() / "clouds/0.bin", 1);
  const auto recording = test::require_ok(open_list(folder.path() / "list.yaml"));
  const Eigen::Matrix3d R = recording.T_camera_lidar().linear();
  CHECK((R * Eigen::Vector3d::UnitX()).isApprox(Eigen::Vector3d::UnitZ(), 0.1));
  CHECK((R * Eigen::Vector3d::UnitZ()).isApprox(-Eigen::Vector3d::UnitY(), 0.1));
}

TEST_CASE("a written list reads back as it was") {
  const test::TemporaryFolder folder;
  const auto camera =
      test::require_ok(Camera::make(CameraModel::double_sphere, 32, 16, {10.1, 10.2, 15, 8}, {-0.2, 0.6}));
  const RigidTransform T_camera_lidar = motion(0.3, 1.2, -0.7, 0.1, -0.2, 0.3);
  auto writer = test::require_ok(ListWriter::create(folder.path() / "out", camera, T_camera_lidar));
  const LidarScan scan{{}, {{1, 2, 3, 0.25f}, {4, 5, 6, 1}}};
  test::require_ok(writer.append(image_of(9), scan, std::vector<float>(32 * 16, 4.f)));
  const auto recording = test::require_ok(open_list(folder.path() / "out/recording.yaml"));
  CHECK(recording.camera().model() == CameraModel::double_sphere);
  CHECK(recording.camera().fx() == 10.1);
  CHECK(recording.camera().distortion() == camera.distortion());
  CHECK(recording.T_camera_lidar().isApprox(T_camera_lidar, 1e-15));
  REQUIRE(recording.size() == 1);
  const auto pair = test::require_ok(recording.frame(0));
  CHECK(pair.image.pixels == image_of(9).pixels);
  REQUIRE(pair.scan.points.size() == 2);
  CHECK(std::memcmp(pair.scan.points.data(), scan.points.data(), 2 * sizeof(LidarPoint)) == 0);
  CHECK(fs::exists(folder.path() / "out/depth" / (recording.frame_name(0) + ".png")));

  write_file(folder.path() / "file", "");
  CHECK(ListWriter::create(folder.path() / "file/out", camera, T_camera_lidar).error().code == "write_failed");
}

TEST_CASE("16-bit images are scaled by the bits of their camera, and remarked when they seem to have fewer") {
  const test::TemporaryFolder folder;
  const fs::path path = folder.path() / "deep.pgm";
  write_file(path, std::string("P5 4 1 65535\n\x0f\xff\x08\x00\x00\x10\x00\x00", 21));  // 4095, 2048, 16, 0
  const Image dark = test::require_ok(read_image(path));
  CHECK(dark.pixels == std::vector<std::uint8_t>{15, 8, 0, 0});
  REQUIRE(dark.notes.remarks.size() == 1);
  CHECK(dark.notes.remarks[0].code == ErrorCode::image_bits);
  CHECK(mentions(dark.notes.remarks[0], "stay below 4096 (the greatest is 4095); if the camera has 12 bits, write"));
  const Image scaled = test::require_ok(read_image(path, Colours::rgb, std::nullopt, 12));
  CHECK(scaled.pixels == std::vector<std::uint8_t>{255, 128, 1, 0});
  CHECK(scaled.notes.remarks.empty());
}

TEST_CASE("images are read in colour when that is asked for and the file has it, and their grey is the same") {
  const test::TemporaryFolder folder;
  // Red, green, blue and grey, two rows of them; PPM and PGM are as plain as files of pixels can be.
  const std::string row("\xff\0\0\0\xff\0\0\0\xff\x80\x80\x80", 12);
  write_file(folder.path() / "colour.ppm", "P6 4 2 255\n" + row + row);
  const Image colour = test::require_ok(read_image(folder.path() / "colour.ppm", Colours::rgb));
  CHECK(std::string(colour.rgb.begin(), colour.rgb.end()) == row + row);
  const Image grey = test::require_ok(read_image(folder.path() / "colour.ppm"));
  CHECK(grey.rgb.empty());
  CHECK(grey.pixels == colour.pixels);
  CHECK(grey.pixels == std::vector<std::uint8_t>{76, 150, 29, 128, 76, 150, 29, 128});

  write_file(folder.path() / "grey.pgm", "P5 2 1 255\n\x10\x20");
  const Image plain = test::require_ok(read_image(folder.path() / "grey.pgm", Colours::rgb));
  CHECK(plain.rgb.empty());
  CHECK(plain.pixels == std::vector<std::uint8_t>{0x10, 0x20});
}
