"""calib-eval on recordings of rosbag2, which others have written, against the same frames in a layout that it knew before."""

import dataclasses
import json
import shutil
import subprocess
import sys

import numpy as np
import pytest
from conftest import numbers_of

sys.path.insert(0, str(__import__("pathlib").Path(__file__).parents[1] / "support"))
import write_bag as bag  # noqa: E402

DONE, FAILED, USAGE = range(3)
SEARCHES = ["--rotation-deg", 1, "--starts", 4]


@pytest.fixture(scope="module")
def drive(bin_dir, tmp_path_factory):
    ended = subprocess.run([bin_dir / "calib-sim", "--dump", tmp_path_factory.mktemp("drive"), "--rate", "0.2", "--width", "480",
                            "--height", "144", "--frames", "5", "--lidar-step-deg", "0.4", "--lidar-fov-deg", "140"],
                           capture_output=True, text=True, timeout=250, check=True)
    return bag.Drive(json.loads(ended.stdout.splitlines()[-1])["drive"])


@pytest.fixture(scope="module")
def expected(evaluate, drive, tmp_path_factory):
    """The result on the frames as a list, whose extrinsic has the numbers of /tf_static."""
    folder = tmp_path_factory.mktemp("list")
    T, P = drive.T_camera_lidar, drive.P_left
    height, width = drive.pixels("image_02", drive.names[0]).shape
    (folder / "recording.yaml").write_text(json.dumps({
        "camera": {"model": "rectified", "size": [width, height], "intrinsics": [P[0], P[5], P[2], P[6]]},
        "T_camera_lidar": {"translation_m": list(T[:3, 3]), "quaternion_xyzw": list(bag.quaternion_xyzw(T[:3, :3]))},
        "baseline_m": (P[3] - drive.P_right[3]) / P[0], "images": str(drive.folder / "image_02/data"),
        "right_images": str(drive.folder / "image_03/data"), "clouds": str(drive.folder / "velodyne_points/data")}))
    ended = evaluate("calibrate", "--dataset", "list", "--root", folder / "recording.yaml", "--depth", "stereo", *SEARCHES,
                     "--json", folder / "result.json")
    assert ended.exit == DONE, ended.err
    return numbers_of(folder / "result.json")


def calibrate(evaluate, root, tmp_path, *options):
    ended = evaluate("calibrate", "--dataset", "rosbag2", "--root", root, "--depth", "stereo", *SEARCHES,
                     "--json", tmp_path / "result.json", *options)
    assert ended.exit == DONE, ended.err
    return ended, numbers_of(tmp_path / "result.json")


def refusal(evaluate, root, *options, depth=("--depth", "stereo")):
    """The one line that says why."""
    ended = evaluate("calibrate", "--dataset", "rosbag2", "--root", root, *depth, *SEARCHES, *options)
    assert ended.exit == FAILED, ended.err
    return ended.err.splitlines()[-1]


# --- the same frames ---

@pytest.mark.parametrize("storage, compression", [("mcap", None), ("sqlite3", None), ("sqlite3", "file"), ("sqlite3", "message"),
                                                  ("mcap", "message")])
def test_a_folder_of_rosbags_gives_the_result_of_the_same_frames(evaluate, drive, expected, tmp_path, storage, compression):
    root = bag.write_rosbag2(tmp_path / "bag", drive.messages(), storage, compression)
    ended, numbers = calibrate(evaluate, root, tmp_path)
    assert numbers == expected
    (line,) = ended.err.splitlines()
    assert line == ("calib-eval: reads /camera/left/image_rect, /lidar/points, /camera/left/camera_info (P: rectified images), "
                    "the transform from lidar to camera_left of /tf_static, /camera/right/image_rect, /camera/right/camera_info")


@pytest.mark.parametrize("compression, options", [
    ("none", {}), ("lz4", {}), ("zstd", {}), ("zstd", {"chunk_size": 10_000}), ("none", {"use_chunking": False}),
    ("lz4", {"use_statistics": False, "use_summary_offsets": False, "repeat_channels": False, "repeat_schemas": False})])
def test_a_file_of_mcap_ros2_support_gives_it_too(evaluate, drive, expected, tmp_path, compression, options):
    path = bag.write_mcap(tmp_path / "drive.mcap", drive.messages(), compression, **options)
    assert calibrate(evaluate, path, tmp_path)[1] == expected


def test_files_that_follow_each_other_are_one_recording(evaluate, drive, expected, tmp_path):
    messages = list(drive.messages())
    # Without metadata.yaml, as a recorder leaves them that was killed; the tenth comes after the second.
    for number, part in {2: messages[:11], 10: messages[11:]}.items():
        bag.write_mcap(tmp_path / f"drive_{number}.mcap", part)
    assert calibrate(evaluate, tmp_path, tmp_path)[1] == expected


def test_transforms_that_never_change_may_come_by_tf_and_by_way_of_other_frames(evaluate, drive, expected, tmp_path):
    messages = list(drive.messages(direct_tf=False, tf="/tf"))
    path = bag.write_mcap(tmp_path / "drive.mcap", [*messages, dataclasses.replace(messages[0], stamp=messages[-1].stamp)])
    ended, (cells, _) = calibrate(evaluate, path, tmp_path)
    assert "of /tf_static and /tf" in ended.err
    # Products of matrices round.
    assert cells[0]["hits"] == expected[0][0]["hits"]
    assert cells[0]["hit_rotation_error_deg"] == pytest.approx(expected[0][0]["hit_rotation_error_deg"], abs=1e-3)


def test_a_transform_that_changes_is_no_extrinsic(evaluate, drive, tmp_path):
    messages = list(drive.messages(tf="/tf"))
    moved = drive.T_camera_lidar.copy()
    moved[0, 3] += 0.01
    messages.append(bag.Sent("/tf", bag.TRANSFORMS, messages[-1].stamp,
                             bag.transforms(messages[-1].stamp, ("camera_left", "lidar", moved))))
    assert "from 'lidar' to 'camera_left' changes during the recording" in refusal(
        evaluate, bag.write_mcap(tmp_path / "drive.mcap", messages))


def test_compressed_images_are_read(evaluate, drive, tmp_path):
    def compressed():
        for sent in drive.messages():
            if sent.type == bag.IMAGE:
                pixels = sent.message.data.reshape(sent.message.height, sent.message.width)
                yield bag.Sent(sent.topic + "/compressed", bag.COMPRESSED_IMAGE, sent.stamp,
                               bag.compressed_image(sent.stamp, "camera_left", pixels))
            else:
                yield sent

    ended, (cells, _) = calibrate(evaluate, bag.write_mcap(tmp_path / "drive.mcap", compressed()), tmp_path)
    assert cells[0]["hits"] == 4
    assert "/camera/left/image_rect/compressed" in ended.err


def test_depth_of_a_topic_is_used(evaluate, drive, tmp_path):
    """Made of the LiDAR's points: what matters here is that it arrives, in millimetres and in metres."""
    def with_depth(encoding):
        for sent in drive.messages(right=False):
            yield sent
            if sent.type == bag.IMAGE:
                yield bag.Sent("/camera/depth/image_raw", bag.IMAGE, sent.stamp,
                               bag.depth_image(sent.stamp, "camera_left", drive, encoding))

    for encoding in ("16UC1", "32FC1"):
        path = bag.write_mcap(tmp_path / "drive.mcap", with_depth(encoding))
        ended = evaluate("curve", "--dataset", "rosbag2", "--root", path, "--depth", "topic", "--points", 3)
        assert ended.exit == DONE, ended.err
        assert "depth of /camera/depth/image_raw" in ended.err


def test_the_camera_and_the_extrinsic_of_a_file_go_first(evaluate, drive, expected, tmp_path):
    T, P = drive.T_camera_lidar, drive.P_left
    height, width = drive.pixels("image_02", drive.names[0]).shape
    (tmp_path / "own.yaml").write_text(json.dumps({
        "camera": {"model": "rectified", "size": [width, height], "intrinsics": [P[0], P[5], P[2], P[6]]},
        "T_camera_lidar": {"translation_m": list(T[:3, 3]), "quaternion_xyzw": list(bag.quaternion_xyzw(T[:3, :3]))},
        "baseline_m": (P[3] - drive.P_right[3]) / P[0]}))
    path = bag.write_mcap(tmp_path / "drive.mcap", drive.messages(tf=None, info=False))
    ended, numbers = calibrate(evaluate, path, tmp_path, "--calibration", tmp_path / "own.yaml")
    assert numbers == expected
    assert f"the camera of {tmp_path}/own.yaml" in ended.err


# --- what is missing, or there twice ---

def test_what_is_missing_is_named_with_what_there_is(evaluate, drive, tmp_path):
    path = tmp_path / "drive.mcap"
    bag.write_mcap(path, drive.messages(tf=None))
    assert ("no transform from 'lidar' to 'camera_left' is in the recording's /tf_static or /tf; it has no transform at all; give "
            "T_camera_lidar in a file with --calibration") in refusal(evaluate, path)
    bag.write_mcap(path, drive.messages(info=False))
    assert "no topic of the recording has the CameraInfo of /camera/left/image_rect" in refusal(evaluate, path)
    bag.write_mcap(path, (sent for sent in drive.messages() if sent.type != bag.CLOUD))
    line = refusal(evaluate, path)
    assert "no topic of the recording has clouds; it holds /camera/left/camera_info" in line
    bag.write_mcap(path, drive.messages(right=False))
    assert "images of a right camera" in refusal(evaluate, path)
    assert "no topic of the recording has depth" in refusal(evaluate, path, depth=("--depth", "topic"))
    bag.write_mcap(path, drive.messages(late_ns=10**10))
    assert "at least 10000 ms apart" in refusal(evaluate, path)


def test_a_topic_is_chosen_where_there_are_several(evaluate, drive, expected, tmp_path):
    def twice():
        for sent in drive.messages():
            yield sent
            if sent.type == bag.CLOUD:
                yield dataclasses.replace(sent, topic="/rear/points")

    path = bag.write_mcap(tmp_path / "drive.mcap", twice())
    line = refusal(evaluate, path)
    assert "2 topics of the recording have clouds: /lidar/points (sensor_msgs/msg/PointCloud2, 5 messages), /rear/points" in line
    assert line.endswith("choose one with --cloud-topic")
    assert calibrate(evaluate, path, tmp_path, "--cloud-topic", "/lidar/points")[1] == expected
    assert "the recording has no topic /front/points; there are /lidar/points" in refusal(evaluate, path, "--cloud-topic",
                                                                                         "/front/points")
    assert "is no topic with clouds" in refusal(evaluate, path, "--cloud-topic", "/tf_static")


def test_a_message_that_calibd_would_not_accept_costs_its_frame(evaluate, drive, tmp_path):
    def damaged():
        for i, sent in enumerate(drive.messages()):
            if sent.type == bag.CLOUD and i == 1:
                sent.message.point_step = 5000
            yield sent

    ended, _ = calibrate(evaluate, bag.write_mcap(tmp_path / "drive.mcap", damaged()), tmp_path)
    assert f"frame {bag.START_NS} is left out: point_step is 5000" in ended.err
    assert ended.out.startswith("4 frames")


# --- files that are damaged ---

@pytest.mark.parametrize("compression", ["none", "lz4", "zstd"])
def test_a_file_that_ends_early_gives_what_it_holds(evaluate, drive, tmp_path, compression):
    path = bag.write_mcap(tmp_path / "drive.mcap", drive.messages(), compression)
    whole = path.read_bytes()
    path.write_bytes(whole[:len(whole) * 4 // 5])
    ended, _ = calibrate(evaluate, path, tmp_path)
    assert f"{path} ends early or is damaged" in ended.err
    assert ended.out.startswith(("3 frames", "4 frames"))


@pytest.mark.parametrize("compression", [None, "file"])
def test_so_does_a_database(evaluate, drive, tmp_path, compression):
    root = bag.write_rosbag2(tmp_path / "bag", drive.messages(), "sqlite3", compression)
    (path,) = root.glob("*.db3*")
    whole = path.read_bytes()
    path.write_bytes(whole[:len(whole) * 4 // 5])
    ended, _ = calibrate(evaluate, root, tmp_path)
    assert f"{path} " in ended.err and ("ends early" in ended.err or "cut short" in ended.err)
    assert ended.out.startswith(("3 frames", "4 frames"))


def test_a_damaged_chunk_is_told(evaluate, drive, tmp_path):
    path = bag.write_mcap(tmp_path / "drive.mcap", drive.messages(), "zstd", chunk_size=300_000)
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    path.write_bytes(whole)
    ended, _ = calibrate(evaluate, path, tmp_path)
    assert "chunks of" in ended.err and "are damaged" in ended.err


def test_what_is_no_recording_is_told(evaluate, drive, tmp_path):
    assert "does not exist" in refusal(evaluate, tmp_path / "none")
    assert "holds no recording (.mcap or .db3)" in refusal(evaluate, tmp_path)
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n" + bytes(100))
    assert "is a recording of ROS 1; rosbags-convert" in refusal(evaluate, tmp_path / "old.bag")
    (tmp_path / "text.mcap").write_text("not a recording\n")
    assert "is neither MCAP nor SQLite" in refusal(evaluate, tmp_path / "text.mcap")
    (tmp_path / "empty.mcap").write_bytes(b"")
    assert "is neither MCAP nor SQLite" in refusal(evaluate, tmp_path / "empty.mcap")
    assert "is not a regular file" in refusal(evaluate, "/dev/zero")


def test_a_file_that_metadata_names_may_be_missing(evaluate, drive, expected, tmp_path):
    root = bag.write_rosbag2(tmp_path / "bag", drive.messages())
    text = (root / "metadata.yaml").read_text()
    (root / "metadata.yaml").write_text(text.replace("  - bag.mcap\n", "  - bag.mcap\n  - bag_1.mcap\n"))
    ended, numbers = calibrate(evaluate, root, tmp_path)
    assert "bag_1.mcap, which metadata.yaml names, is not there" in ended.err
    assert numbers == expected
    (root / "metadata.yaml").write_text(text[:200] + "\n\t- {")
    ended, numbers = calibrate(evaluate, root, tmp_path)
    assert "all files of the folder are read" in ended.err and numbers == expected
    shutil.rmtree(root)


def test_options_of_another_layout_are_refused(evaluate, drive):
    ended = evaluate("curve", "--dataset", "kitti-raw", "--root", drive.folder, "--depth", "stereo", "--cloud-topic", "/a")
    assert ended.exit == USAGE and "--cloud-topic: is for rosbag2" in ended.err
    ended = evaluate("curve", "--dataset", "kitti-raw", "--root", drive.folder, "--depth", "topic")
    assert ended.exit == USAGE and "topic is for rosbag2" in ended.err
    ended = evaluate("curve", "--dataset", "rosbag2", "--root", drive.folder, "--depth", "stereo", "--camera", "image_00")
    assert ended.exit == USAGE and "is not for rosbag2, which has --image-topic" in ended.err


def test_raw_images_are_seen_through_their_lens(evaluate, drive, tmp_path):
    """D counts for raw images and not for rectified ones: the same bytes under another name."""
    def with_lens(topic):
        for sent in drive.messages(right=False):
            if sent.type == bag.CAMERA_INFO:
                sent.message.d = np.array([-0.3, 0.1, 0, 0, 0])
            yield dataclasses.replace(sent, topic=topic) if sent.type == bag.IMAGE else sent

    depth = tmp_path / "depth"
    depth.mkdir()
    for i in range(5):
        np.save(depth / f"{bag.START_NS + i * 100_000_000}.npy", drive.dense_depth(i))
    for topic, model in {"/camera/left/image_raw": "plumb_bob", "/camera/left/image_rect_color": "rectified"}.items():
        path = bag.write_mcap(tmp_path / "drive.mcap", with_lens(topic))
        ended = evaluate("curve", "--dataset", "rosbag2", "--root", path, "--depth-dir", depth, "--depth-kind", "depth",
                         "--points", 3, "--json", tmp_path / "r.json")
        assert ended.exit == DONE, ended.err
        recording = json.loads((tmp_path / "r.json").read_text())["recording"]
        assert recording["camera"]["model"] == model
        assert recording["frames"][0] == str(bag.START_NS)
