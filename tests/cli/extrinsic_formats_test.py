"""calibctl import and export, on files as their formats' documentation has them."""

import json
import math
import pathlib

import pytest

from conftest import DONE, FAILED, NO, NOT_FOUND, USAGE

FILES = pathlib.Path(__file__).parent / "extrinsic_files"

# Each means the same extrinsic, expected.json, which was computed from the mounting of the camera and not by calibctl.
GOLDEN = {
    "tf-commands": ("tf", ["publisher.sh"], []),
    "tf-topic": ("tf", ["tf_static.yaml"], ["--lidar", "lidar"]),
    "tf-body": ("tf", ["tf_static.yaml"], ["--lidar", "lidar", "--camera", "camera_link", "--camera-axes", "body"]),
    "kitti": ("kitti", ["calib_velo_to_cam.txt", "calib_cam_to_cam.txt"], ["--camera", "rectified2"]),
    "kitti360": ("kitti360", ["calib_cam_to_velo.txt"], []),
    "kalibr": ("kalibr", ["camchain.yaml"], ["--camera", "cam1"]),
    "urdf": ("urdf", ["robot.urdf"], []),
    "opencalib": ("opencalib", ["extrinsic.json"], []),
    "nuscenes": ("nuscenes", ["calibrated_sensor.json"], []),
    "nuscenes-channels": ("nuscenes", ["calibrated_sensor.json", "sensor.json"],
                          ["--camera", "CAM_FRONT", "--lidar", "LIDAR_TOP"]),
    "autoware": ("autoware", ["sensor_kit_calibration.yaml", "sensors_calibration.yaml"],
                 ["--lidar", "velodyne_top_base_link"]),
    "autoware-optical": ("autoware", ["sensor_kit_calibration.yaml"],
                         ["--camera", "camera0/camera_optical_link", "--lidar", "velodyne_top_base_link"]),
    "mixed": ("autoware", ["sensor_kit_calibration.yaml"],
              ["--lidar", "points", "--with", "tf:{folder}/housing.sh"]),
}
FORMATS = ["tf", "kitti", "autoware", "kalibr", "urdf", "opencalib", "nuscenes", "kitti360"]


def matrix_of(transform):
    x, y, z, w = transform["quaternion_xyzw"]
    return [[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]


def distance(transform, expected):
    """The largest difference of an entry: rotation matrix and metres."""
    rows = matrix_of(transform)
    turned = max(abs(rows[i][j] - expected["matrix"][i][j]) for i in range(3) for j in range(3))
    moved = max(abs(a - b) for a, b in zip(transform["translation_m"], expected["translation_m"]))
    return max(turned, moved)


@pytest.fixture(scope="module")
def expected():
    return json.loads((FILES / "expected.json").read_text())


def imported(calibctl, form, *arguments):
    done = calibctl("import", "--json", "--format", form, *arguments)
    assert done.exit == DONE, done.err
    return json.loads(done.out)


@pytest.mark.parametrize("name", GOLDEN)
def test_a_golden_file_means_what_its_format_says(bare, tmp_path, expected, name):
    form, files, options = GOLDEN[name]
    (tmp_path / "housing.sh").write_text("--frame-id velodyne_top_base_link --child-frame-id points\n")
    options = [option.format(folder=tmp_path) for option in options]
    assert distance(imported(bare, form, *[FILES / file for file in files], *options), expected) < 1e-9


@pytest.fixture
def config(bare, tmp_path, expected):
    """As `calibctl import` prints it."""
    done = bare("import", "--format", "opencalib", FILES / "extrinsic.json")
    assert done.exit == DONE
    assert done.out.startswith("# From ") and "\nT_camera_lidar:\n  translation_m: [-0.059" in done.out
    file = tmp_path / "snippet.yaml"
    file.write_text(done.out)
    return file


@pytest.mark.parametrize("form", FORMATS)
def test_what_is_exported_is_imported_as_the_same(bare, tmp_path, config, expected, form):
    done = bare("export", "--format", form, "--config", config)
    assert (done.exit, done.err) == (DONE, f"calibctl: exported from {config}\n")
    file = tmp_path / "exported"
    file.write_text(done.out)
    assert distance(imported(bare, form, file), expected) < 1e-9


@pytest.mark.parametrize("form", ["yaml", "json", "arguments"])
def test_tf_is_written_in_three_forms(bare, tmp_path, config, expected, form):
    done = bare("export", "--format", "tf", "--config", config, "--tf-form", form, "--parent", "base_link",
                "--lidar", "lidar", "--with", FILES / "publisher.sh", "--camera", "front_optical")
    assert done.exit == DONE, done.err
    file = tmp_path / "exported"
    file.write_text(done.out)
    assert distance(imported(bare, "tf", file, "--with", FILES / "publisher.sh", "--camera", "front_optical",
                             "--lidar", "lidar"), expected) < 1e-9


def test_the_pose_of_a_camera_is_written_into_autowares_chain(bare, config):
    done = bare("export", "--format", "autoware", "--config", config, "--parent", "sensor_kit_base_link", "--lidar",
                "velodyne_top_base_link", "--with", FILES / "sensor_kit_calibration.yaml")
    assert done.exit == DONE, done.err
    was = (FILES / "sensor_kit_calibration.yaml").read_text().splitlines()
    now = done.out.splitlines()
    assert now[:2] == was[:2]
    for old, new in zip(was[2:8], now[2:], strict=True):
        assert old.split(":")[0] == new.split(":")[0]
        assert math.isclose(float(old.split(":")[1]), float(new.split(":")[1]), abs_tol=1e-9)


def test_kitti_is_written_before_rectification(bare, tmp_path, config, expected):
    done = bare("export", "--format", "kitti", "--config", config, "--camera", "rectified2", "--with",
                FILES / "calib_cam_to_cam.txt")
    assert done.exit == DONE, done.err
    (tmp_path / "velo").write_text(done.out)
    assert distance(imported(bare, "kitti", tmp_path / "velo", FILES / "calib_cam_to_cam.txt", "--camera",
                             "rectified2"), expected) < 1e-9
    assert distance(imported(bare, "kitti", tmp_path / "velo"), expected) > 0.01


def test_the_extrinsic_in_force_is_exported_from_its_verified_record(calibctl):
    done = calibctl("export", "--format", "kalibr")
    assert done.exit == DONE, done.err
    assert done.out.startswith("cam0:\n  T_cam_lidar:\n  - [")
    assert "verified, in force" in done.err
    assert calibctl("export", "--format", "kalibr", "--record", "1").exit == DONE
    assert calibctl("export", "--format", "kalibr", "--record", "99").exit == NOT_FOUND
    unknown = calibctl("export", "--format", "kalibr", "no-such-pair")
    assert unknown.exit == NOT_FOUND and "no pair 'no-such-pair'; it has " in unknown.err


@pytest.mark.parametrize("options, remedy", [
    (["--inverse"], "leave --inverse out"), (["--camera-axes", "body"], "use --camera-axes optical")])
def test_an_implausible_reading_is_refused_with_the_remedy(bare, tmp_path, options, remedy):
    file = tmp_path / "forward.txt"
    file.write_text("R: 0 -1 0 0 0 -1 1 0 0\nT: 0.1 -0.2 -0.3\n")
    refused = bare("import", "--format", "kitti", file, *options)
    assert (refused.exit, refused.out) == (NO, "")
    assert remedy in refused.err and "is no plausible T_camera_lidar" in refused.err
    assert bare("import", "--format", "kitti", file, *options, "--no-check").exit == DONE
    assert bare("import", "--format", "kitti", file).exit == DONE


def test_an_inverse_is_refused_with_the_remedy(bare, tmp_path):
    """KITTI-360's matrix, which is the other way round, in a file of KITTI."""
    file = tmp_path / "inverse.txt"
    file.write_text("R: 0 0 1 -1 0 0 0 -1 0\nT: 0.3 0.1 -0.2\n")
    refused = bare("import", "--format", "kitti", file)
    assert refused.exit == NO and "it looks like its inverse: use --inverse" in refused.err
    assert bare("import", "--format", "kitti", file, "--inverse").exit == DONE


@pytest.mark.parametrize("arguments, exit_status, message", [
    (["autoware", "sensor_kit_calibration.yaml"], USAGE,
     "name the frame with --lidar; there are: camera0/camera_link, camera0/camera_optical_link, sensor_kit_base_link"),
    (["tf", "tf_static.yaml", "--lidar", "velodyne"], NOT_FOUND, "there is no frame 'velodyne'; there are: camera_link"),
    (["nuscenes", "sensor.json"], USAGE, "name the frame with --camera; there are: none"),
    (["kitti", "calib_velo_to_cam.txt", "--camera", "rectified2"], NOT_FOUND, "need the file with R_rect_00"),
    (["kalibr", "extrinsic.json"], FAILED, "holds no camera cam0"),
    (["opencalib", "camchain.yaml"], FAILED, "camchain.yaml: is not JSON"),
    (["urdf", "robot.urdf", "--lidar", "wheel"], NOT_FOUND, "joints that are not fixed are left out"),
    (["tf", "missing.yaml"], FAILED, "missing.yaml"),
])
def test_an_error_names_the_file_and_the_way_out(bare, arguments, exit_status, message):
    form, file, *options = arguments
    refused = bare("import", "--format", form, FILES / file, *options)
    assert (refused.exit, refused.out) == (exit_status, "")
    assert message in refused.err and len(refused.err.splitlines()) == 1


def test_a_file_beyond_the_bound_is_not_read(bare, tmp_path):
    file = tmp_path / "large.json"
    with open(file, "wb") as out:
        out.truncate(1 << 30)
    refused = bare("import", "--format", "nuscenes", file)
    assert refused.exit == FAILED and "large.json" in refused.err
    assert bare("import", "--format", "tf", tmp_path).exit == FAILED


def test_names_that_would_break_a_file_are_refused(bare, config):
    for name in ('a"b', "a b", "x: y", "--x"):
        refused = bare("export", "--format", "tf", "--config", config, f"--camera={name}")
        assert refused.exit == USAGE and "is no name of a frame" in refused.err
    assert bare("export", "--format", "kalibr", "--config", config, "--parent", "base").exit == USAGE
    assert bare("export", "--format", "pcl", "--config", config).exit == USAGE


def test_a_pair_of_a_configuration_is_exported(bare, source_dir):
    done = bare("export", "--format", "opencalib", "--config", source_dir / "systemd" / "calibd.yaml")
    assert done.exit == DONE, done.err
    assert json.loads(done.out)["lidar-to-camera-extrinsic"]["param"]["sensor_calib"]["data"][2] == [1, 0, 0, 0]
