"""calib-eval on the layouts of other data sets, and calib-replay on recordings of rosbag2, from the same simulated frames."""

import json
import pathlib
import shutil
import subprocess
import sys
import types

import numpy as np
import pytest
from conftest import numbers_of
from PIL import Image

sys.path.insert(0, str(pathlib.Path(__file__).parents[1] / "support"))
import write_bag as bag  # noqa: E402

DONE, FAILED, USAGE, NOT_FOUND = range(4)
SEARCHES = ["--depth", "stereo", "--rotation-deg", 1, "--starts", 4]


@pytest.fixture(scope="module")
def run(bin_dir):
    def run(program, *arguments):
        ended = subprocess.run([bin_dir / program, *map(str, arguments)], capture_output=True, text=True, timeout=250)
        return types.SimpleNamespace(exit=ended.returncode, out=ended.stdout, err=ended.stderr)

    return run


@pytest.fixture(scope="module")
def drive(run, tmp_path_factory):
    ended = run("calib-sim", "--dump", tmp_path_factory.mktemp("drive"), "--rate", "0.2", "--width", "480", "--height", "144",
                "--frames", "5", "--lidar-step-deg", "0.4", "--lidar-fov-deg", "140")
    assert ended.exit == DONE, ended.err
    return bag.Drive(json.loads(ended.out.splitlines()[-1])["drive"])


def text(matrix):
    return " ".join(repr(float(number)) for number in np.asarray(matrix).reshape(-1))


# --- the object detection set of KITTI ---

@pytest.fixture
def kitti_object(drive, tmp_path):
    """The folder `training`, with the files of the drive."""
    root = tmp_path / "training"
    shutil.copytree(drive.folder / "image_02/data", root / "image_2")
    shutil.copytree(drive.folder / "image_03/data", root / "image_3")
    shutil.copytree(drive.folder / "velodyne_points/data", root / "velodyne")
    (root / "calib").mkdir()
    for name in drive.names:
        (root / "calib" / f"{name}.txt").write_text(
            f"P0: {text(drive.P_left)}\nP1: {text(drive.P_left)}\nP2: {text(drive.P_left)}\nP3: {text(drive.P_right)}\n"
            f"R0_rect: {text(drive.R_rect)}\nTr_velo_to_cam: {text(np.hstack([drive.R, drive.T[:, None]]))}\n\n")
    return root


def test_frames_of_kittis_object_set_give_the_result_of_the_same_frames_of_a_drive(run, drive, kitti_object, tmp_path):
    assert run("calib-eval", "calibrate", "--dataset", "kitti-raw", "--root", drive.folder, *SEARCHES, "--json",
               tmp_path / "raw.json").exit == DONE
    for root in (kitti_object, kitti_object.parent):
        ended = run("calib-eval", "calibrate", "--dataset", "kitti-object", "--root", root, *SEARCHES, "--json",
                    tmp_path / "object.json")
        assert ended.exit == DONE and ended.err == "", ended.err
        assert numbers_of(tmp_path / "object.json") == numbers_of(tmp_path / "raw.json")


def test_frames_of_another_calibration_are_left_out(run, drive, kitti_object):
    other = kitti_object / "calib" / f"{drive.names[1]}.txt"
    other.write_text(other.read_text().replace(repr(float(drive.T[2])), repr(float(drive.T[2]) + 0.01)))
    ended = run("calib-eval", "curve", "--dataset", "kitti-object", "--root", kitti_object, "--depth", "stereo", "--points", 3)
    assert ended.exit == DONE, ended.err
    assert f"1 of 5 frames are left out: another calibration for {drive.names[1]}" in ended.err


def test_what_is_wrong_with_an_object_set_is_told(run, drive, kitti_object, tmp_path):
    def refusal(*options):
        ended = run("calib-eval", "curve", "--dataset", "kitti-object", "--root", kitti_object, "--depth", "stereo", *options)
        assert ended.exit == FAILED
        return ended.err

    assert "no camera image_02, only image_2 and image_3" in refusal("--camera", "image_02")
    assert "no right images" in refusal("--camera", "image_3")
    calib = kitti_object / "calib" / f"{drive.names[0]}.txt"
    calib.write_text(calib.read_text().replace("Tr_velo_to_cam", "Tr_cam_to_velo"))
    assert f"{calib} has no 12 finite numbers under Tr_velo_to_cam" in refusal()
    calib.unlink()
    assert f"{calib}: cannot be read" in refusal()
    shutil.rmtree(kitti_object / "velodyne")
    assert "has no folder velodyne" in refusal()


# --- nuScenes ---

def pose(T):
    x, y, z, w = bag.quaternion_xyzw(T[:3, :3])
    return {"translation": list(T[:3, 3]), "rotation": [w, x, y, z]}


def transform(yaw, x, y, z):
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = x, y, z
    return T


class NuScenes:
    """The drive as a scene: a vehicle at 20 m/s that turns, whose camera is triggered 40 ms after its LiDAR."""

    def __init__(self, root, drive):
        self.root, self.drive = root, drive
        self.tables = {name: [] for name in ("sensor", "calibrated_sensor", "sample", "sample_data", "ego_pose", "scene")}
        (root / "v1.0-mini").mkdir()
        self.T_ego_lidar = transform(-1.57, 0.94, 0, 1.84)
        self.sensor("CAM_FRONT", "camera", self.T_ego_lidar @ np.linalg.inv(drive.T_camera_lidar), drive.P_left)
        self.sensor("LIDAR_TOP", "lidar", self.T_ego_lidar)
        self.sensor("CAM_BACK", "camera", np.eye(4), drive.P_left)
        self.tables["scene"].append({"token": "scene-token", "name": "scene-0061"})
        for i, name in enumerate(drive.names):
            self.sample(i, name)
        self.write()

    def sensor(self, channel, modality, T_ego_sensor, P=None):
        self.tables["sensor"].append({"token": channel, "channel": channel, "modality": modality})
        K = [] if P is None else [[P[0], 0, P[2]], [0, P[5], P[6]], [0, 0, 1]]
        self.tables["calibrated_sensor"].append({"token": f"c-{channel}", "sensor_token": channel, **pose(T_ego_sensor),
                                                 "camera_intrinsic": K})

    def sample(self, i, name):
        height, width = self.drive.pixels("image_02", name).shape
        T_world_scan, T_world_image = (transform(0.3 + 0.5 * t, 600 + 20 * t, 1600, 0.1) for t in (i, i + 0.04))
        self.tables["sample"].append({"token": f"s{i}", "scene_token": "scene-token"})
        for channel, T, time in (("LIDAR_TOP", T_world_scan, i * 10**6), ("CAM_FRONT", T_world_image, i * 10**6 + 40_000)):
            folder = self.root / "samples" / channel
            folder.mkdir(parents=True, exist_ok=True)
            file = f"samples/{channel}/n015__{channel}__{i}" + (".pcd.bin" if channel == "LIDAR_TOP" else ".png")
            self.tables["ego_pose"].append({"token": f"e-{channel}-{i}", "timestamp": time, **pose(T)})
            self.tables["sample_data"].append({
                "token": f"d-{channel}-{i}", "sample_token": f"s{i}", "ego_pose_token": f"e-{channel}-{i}",
                "calibrated_sensor_token": f"c-{channel}", "timestamp": time, "is_key_frame": True, "filename": file,
                "height": height if channel != "LIDAR_TOP" else 0, "width": width if channel != "LIDAR_TOP" else 0})
        # Between key frames there are others, which are not read.
        self.tables["sample_data"].append({**self.tables["sample_data"][-1], "is_key_frame": False, "filename": "sweeps/none"})
        Image.fromarray(self.drive.pixels("image_02", name)).save(self.root / f"samples/CAM_FRONT/n015__CAM_FRONT__{i}.png")
        points = self.drive.points(name)
        # Where the LiDAR saw them from, 40 ms before.
        T = np.linalg.inv(T_world_scan @ self.T_ego_lidar) @ T_world_image @ self.T_ego_lidar
        moved = points[:, :3] @ T[:3, :3].T + T[:3, 3]
        rows = np.column_stack([moved, points[:, 3], np.arange(len(points)) % 32]).astype(np.float32)
        rows.tofile(self.root / f"samples/LIDAR_TOP/n015__LIDAR_TOP__{i}.pcd.bin")

    def write(self):
        for name, rows in self.tables.items():
            (self.root / "v1.0-mini" / f"{name}.json").write_text(json.dumps(rows, indent=0))


@pytest.fixture
def nuscenes(drive, tmp_path):
    root = tmp_path / "nuscenes"
    root.mkdir()
    return NuScenes(root, drive)


@pytest.fixture
def true_depth(drive, tmp_path):
    folder = tmp_path / "depth"
    folder.mkdir()
    for i in range(len(drive.names)):
        np.save(folder / f"n015__CAM_FRONT__{i}.npy", drive.dense_depth(i))
    return ["--depth-dir", folder, "--depth-kind", "depth"]


def test_points_of_nuscenes_are_moved_to_the_time_of_the_image(run, drive, nuscenes, true_depth, tmp_path):
    """Unmoved, they are 80 cm and more than a degree off."""
    def best(*options):
        ended = run("calib-eval", "curve", "--dataset", "nuscenes", "--root", nuscenes.root, *true_depth, "--points", 5,
                    "--range-deg", 1, "--range-cm", 80, "--json", tmp_path / "r.json", *options)
        assert ended.exit == DONE, ended.err
        result = json.loads((tmp_path / "r.json").read_text())
        assert np.allclose(result["recording"]["T_camera_lidar"]["translation_m"], drive.T_camera_lidar[:3, 3], atol=1e-9)
        assert result["recording"]["frames"] == [f"n015__CAM_FRONT__{i}" for i in range(5)]
        return {curve["axis"]: curve["offset"][int(np.argmax(curve["score"]))] for curve in result["curves"]}, ended.err

    moved, said = best()
    assert moved["yaw"] == 0 and said == ""
    for row in nuscenes.tables["ego_pose"]:
        row["token"] += "-lost"
    nuscenes.write()
    unmoved, said = best("--drive", "scene-0061")
    assert "5 frames have no pose of the vehicle" in said
    assert abs(unmoved["yaw"]) >= 0.5


def test_what_is_wrong_with_nuscenes_is_told(run, nuscenes, true_depth):
    def refusal(*options):
        ended = run("calib-eval", "curve", "--dataset", "nuscenes", "--root", nuscenes.root, *true_depth, *options)
        assert ended.exit == FAILED, ended.err
        return ended.err

    assert "there is no camera FRONT; --camera is one of CAM_BACK, CAM_FRONT" in refusal("--camera", "FRONT")
    assert "has an image of CAM_BACK and a cloud" in refusal("--camera", "CAM_BACK")
    assert "there is no scene scene-1; --drive is one of scene-0061 .. scene-0061" in refusal("--drive", "scene-1")
    shutil.rmtree(nuscenes.root / "samples/LIDAR_TOP")
    assert "5 samples none has its files below" in refusal()
    shutil.copytree(nuscenes.root / "v1.0-mini", nuscenes.root / "v1.0-trainval")
    assert "several folders of tables; give one of" in refusal()
    shutil.rmtree(nuscenes.root / "v1.0-trainval")
    table = nuscenes.root / "v1.0-mini/ego_pose.json"
    table.write_text(table.read_text()[:300])
    assert f"{table}: " in refusal()
    table.unlink()
    assert f"{table} is not there" in refusal()
    (nuscenes.root / "v1.0-mini/sample_data.json").unlink()
    assert "has no folder of tables" in refusal()


# --- calib-replay ---

def test_a_recording_is_replayed_as_its_drive(run, drive, tmp_path):
    root = bag.write_rosbag2(tmp_path / "bag", drive.messages())
    ended = run("calib-replay", "--dataset", "rosbag2", root, "--dump", tmp_path / "out", "--frames", 5)
    assert ended.exit == DONE, ended.err
    assert ended.err.startswith("calib-replay: reads /camera/left/image_rect, /lidar/points")
    again = bag.Drive(json.loads(ended.out.splitlines()[-1])["drive"])
    assert np.allclose(again.T_camera_lidar, drive.T_camera_lidar, atol=1e-9)
    assert len(again.names) == 5
    for i, name in enumerate(again.names):
        for camera in ("image_02", "image_03"):
            assert np.array_equal(again.pixels(camera, name), drive.pixels(camera, drive.names[i]))
        assert np.array_equal(again.points(name), drive.points(drive.names[i]))


def test_a_recording_of_one_camera_is_replayed_too(run, drive, dds_domain, tmp_path):
    path = bag.write_mcap(tmp_path / "drive.mcap", drive.messages(right=False))
    ended = run("calib-replay", "--dataset", "rosbag2", path, "--domain", dds_domain, "--fast")
    assert ended.exit == DONE, ended.err
    assert json.loads(ended.out.splitlines()[-1])["frame"] == 5
    shown = run("calib-replay", "--dataset", "rosbag2", path, "--print-config")
    assert "depth: {source: onnx, model: /usr/share/calibd/models/street-small.yaml}" in shown.out
    without = run("calib-replay", "--dataset", "rosbag2", path, "--domain", dds_domain, "--fast", "--depth-topic", "/depth")
    assert without.exit == FAILED and "no topic of the recording has depth" in without.err


def test_what_is_wrong_with_a_recording_is_told_by_replay(run, drive, tmp_path):
    missing = run("calib-replay", "--dataset", "rosbag2", tmp_path / "nowhere")
    assert missing.exit == NOT_FOUND and missing.err.startswith("recording_not_found: ")
    path = bag.write_mcap(tmp_path / "drive.mcap", drive.messages(tf=None))
    ended = run("calib-replay", "--dataset", "rosbag2", path)
    assert ended.exit == FAILED and "calibration_missing: no transform from 'lidar' to 'camera_left'" in ended.err
    ended = run("calib-replay", drive.folder, "--cloud-topic", "/lidar/points")
    assert ended.exit == USAGE and "--cloud-topic: is for --dataset rosbag2" in ended.err
