"""tools/train/recordings.py: how points of a recording become pixels and depths, and which of them the camera sees."""

import sys

import numpy as np
import pytest


@pytest.fixture(scope="module")
def recordings(source_dir):
    sys.path.insert(0, str(source_dir / "tools/train"))
    import recordings
    return recordings


@pytest.fixture
def camera(recordings):
    return recordings.Camera(640, 192, 400.0, 400.0, 319.5, 95.5)


def test_a_point_is_projected_to_the_pixel_that_sees_it(recordings, camera):
    T = np.array([[0, -1, 0, 0.1], [0, 0, -1, -0.2], [1, 0, 0, -0.3], [0, 0, 0, 1]], float)  # x forward, y left, z up
    uv, z = recordings.project(np.array([[10.3, 0.1, -0.2], [-10, 0, 0], [10, 50, 0]]), T, camera)
    assert uv == pytest.approx(np.array([[319.5, 95.5]])) and z == pytest.approx([10])


def test_points_behind_what_is_near_are_left_out(recordings, camera):
    wall = np.array([[x, y] for x in range(100, 201, 4) for y in range(40, 101, 4)], float)
    behind = wall + 1
    uv, z = np.concatenate([wall, behind]), np.concatenate([np.full(len(wall), 8.0), np.full(len(behind), 20.0)])
    seen = recordings.not_occluded(uv, z, camera)
    assert seen[:len(wall)].all() and not seen[len(wall):].any()


def test_a_road_hides_nothing_of_itself(recordings, camera):
    x, z = np.meshgrid(np.linspace(-6, 6, 60), 1.0 / np.linspace(1 / 40, 1 / 5, 40))
    points = np.stack([x.ravel(), np.full(x.size, 1.6), z.ravel()], axis=1)
    uv, depth = recordings.project(points, np.eye(4), camera)
    assert recordings.not_occluded(uv, depth, camera).all()


def test_no_point_is_no_error(recordings, camera):
    uv, z = recordings.project(np.zeros((0, 3)), np.eye(4), camera)
    assert len(recordings.not_occluded(uv, z, camera)) == 0


def test_a_drive_is_read_with_the_shift_of_its_camera_and_the_baseline(recordings, tmp_path):
    drive = tmp_path / "date" / "drive"
    for folder, suffix in (("image_02", "png"), ("image_03", "png"), ("velodyne_points", "bin")):
        (drive / folder / "data").mkdir(parents=True)
        for name in ("0000000000", "0000000001"):
            (drive / folder / "data" / f"{name}.{suffix}").touch()
    (drive / "velodyne_points/data/0000000001.bin").unlink()
    P = "500 0 300 {} 0 500 100 0 0 0 1 0"
    (drive.parent / "calib_cam_to_cam.txt").write_text(
        f"calib_time: 09-Jan-2012 13:57:47\nR_rect_00: 1 0 0 0 1 0 0 0 1\nS_rect_02: 620 190\nP_rect_02: {P.format(50)}\n"
        f"P_rect_03: {P.format(-200)}\n")
    (drive.parent / "calib_velo_to_cam.txt").write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0 -0.1 -0.3\n")
    recording = recordings.open_recording(drive)
    assert [frame.name for frame in recording.frames] == ["0000000000"]
    assert recording.baseline_m == pytest.approx(0.5)
    assert recording.T_camera_lidar[:3, 3] == pytest.approx([0.1, -0.1, -0.3])
    np.array([1, 2, 3, 0.5, np.nan, 0, 0, 0, 0, 0, 0, 0], "<f4").tofile(recording.frames[0].cloud)
    assert recording.points(recording.frames[0]) == pytest.approx(np.array([[1, 2, 3]]))
    recording.frames[0].cloud.write_bytes(bytes(20))
    with pytest.raises(recordings.RecordingError, match="does not hold whole points"):
        recording.points(recording.frames[0])
