"""calib-sim and calib-replay as a person meets them: exit codes, standard output, standard error."""

import json
import os
import signal
import struct
import subprocess
from pathlib import Path

import pytest

BIN = Path(os.environ["CALIBD_BIN_DIR"])
DOMAIN = os.environ["CALIBD_TEST_DOMAIN"]
SMALL = ["--width", "320", "--height", "96", "--lidar-step-deg", "2"]


def run(program, *arguments):
    return subprocess.run([BIN / program, *map(str, arguments)], capture_output=True, text=True, timeout=60)


def events(output):
    return [json.loads(line) for line in output.splitlines()]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """A short simulated drive in KITTI's layout."""
    done = run("calib-sim", *SMALL, "--seed", 5, "--dump", tmp_path_factory.mktemp("dump"), "--frames", 3)
    assert done.returncode == 0, done.stderr
    return Path(events(done.stdout)[-1]["drive"])


@pytest.mark.parametrize("program", ["calib-sim", "calib-replay"])
def test_help_is_an_answer_and_nonsense_is_a_usage_error(program):
    assert run(program, "--help").returncode == 0
    nonsense = run(program, "--no-such-option", "/tmp")
    assert nonsense.returncode == 2
    assert "--no-such-option" in nonsense.stderr and nonsense.stdout == ""


@pytest.mark.parametrize(
    "arguments",
    [
        ["--knock-deg", "1,2"],
        ["--rate", "0"],
        ["--after", "1", "--after-frames", "2"],
        ["--frame", "3"],
        ["--lidar-dropout", "2"],
        ["--width", "10"],
        ["--cloud-late-ms", "-1"],
        ["--motion-as", "imu"],
    ],
)
def test_options_out_of_bounds_are_usage_errors(arguments):
    done = run("calib-sim", *arguments)
    assert done.returncode == 2
    assert done.stderr


def test_truth_is_told_at_the_start_at_the_knock_and_at_the_end():
    done = run(
        "calib-sim",
        *SMALL,
        "--domain",
        DOMAIN,
        "--fast",
        "--rate",
        2,
        "--frames",
        6,
        "--knock-deg",
        "0,-1,0.5",
        "--knock-cm",
        "-2,0,3",
        "--after-frames",
        4,
    )
    assert done.returncode == 0, done.stderr
    start, knock, end = events(done.stdout)
    assert (start["event"], start["frame"], start["t_s"]) == ("truth", 0, 0)
    assert start["knock_deg"] == [0, 0, 0]
    assert (knock["event"], knock["frame"], knock["t_s"]) == ("truth", 4, 2)
    assert knock["knock_deg"] == pytest.approx([0, -1, 0.5]) and knock["knock_cm"] == pytest.approx(
        [-2, 0, 3]
    )
    assert (end["event"], end["frame"]) == ("end", 6)
    assert end["T_camera_lidar"] == knock["T_camera_lidar"] != start["T_camera_lidar"]
    # The LiDAR's own x, y, z are the camera's z, -x, -y, but for a degree of mounting.
    shift = [
        b - a
        for a, b in zip(start["T_camera_lidar"]["translation_m"], knock["T_camera_lidar"]["translation_m"])
    ]
    assert shift == pytest.approx([0, -0.03, -0.02], abs=0.002)


def test_slow_drift_is_told_once_a_second():
    done = run(
        "calib-sim",
        *SMALL,
        "--domain",
        DOMAIN,
        "--fast",
        "--rate",
        10,
        "--frames",
        35,
        "--drift-deg-per-minute",
        "0,0,6",
    )
    truths = [event for event in events(done.stdout) if event["event"] == "truth"]
    assert [truth["frame"] for truth in truths] == [0, 1, 11, 21, 31]
    assert truths[-1]["knock_deg"][2] == pytest.approx(3.1 / 60 * 6)


@pytest.mark.parametrize("end", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_drive_cleanly(end):
    with subprocess.Popen(
        [BIN / "calib-sim", *SMALL, "--domain", DOMAIN, "--rate", "5"], stdout=subprocess.PIPE, text=True
    ) as vehicle:
        assert json.loads(vehicle.stdout.readline())["event"] == "truth"
        vehicle.send_signal(end)
        rest = vehicle.communicate(timeout=20)[0]
    assert vehicle.returncode == 0
    assert events(rest)[-1]["event"] == "end"


def test_a_wrong_interface_is_an_error_with_a_name():
    done = run("calib-sim", *SMALL, "--domain", DOMAIN, "--interface", "no-such-interface", "--frames", 1)
    assert done.returncode == 1
    # Cyclone has a word of its own before ours.
    assert (
        done.stderr.splitlines()[-1].startswith("dds_failed: domain ") and "no-such-interface" in done.stderr
    )


def test_a_recorded_drive_does_not_know_how_the_vehicle_turned(drive):
    done = run("calib-replay", drive, "--domain", DOMAIN, "--motion-topic", "/imu/data")
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr.startswith("no_motion: ") and "leave out --motion-topic" in done.stderr


@pytest.mark.parametrize("words, expected", [([], "type: imu"), (["--motion-as", "odometry"], "type: odometry")])
def test_print_config_names_the_topic_of_motion(words, expected):
    done = run("calib-sim", *SMALL, "--motion-topic", "/motion", *words, "--print-config")
    assert done.returncode == 0, done.stderr
    assert f"    motion: {{topic: /motion, {expected}}}\n" in done.stdout


def test_print_config_describes_the_vehicle(drive):
    for done in [
        run("calib-sim", *SMALL, "--knock-deg", "1,1,1", "--print-config"),
        run("calib-replay", drive, "--print-config"),
    ]:
        assert done.returncode == 0, done.stderr
        lines = done.stdout.splitlines()
        assert lines[:2] == ["pairs:", "  - name: front"]
        assert "size: [320, 96]" in lines[2] and "baseline_m: 0.54" in lines[5]
        assert lines[3] == "    lidar: {cloud: /lidar/points}"
        # Before any knock.
        start = events(run("calib-sim", *SMALL, "--domain", DOMAIN, "--frames", 1).stdout)[0][
            "T_camera_lidar"
        ]
        printed = json.loads(
            lines[4]
            .split("T_camera_lidar: ")[1]
            .replace("translation_m", '"translation_m"')
            .replace("quaternion_xyzw", '"quaternion_xyzw"')
        )
        for key in ("translation_m", "quaternion_xyzw"):
            assert printed[key] == pytest.approx(start[key], abs=1e-9)


def test_a_dumped_drive_is_the_same_every_time_and_a_knock_changes_its_clouds_only(drive, tmp_path):
    again = run("calib-sim", *SMALL, "--seed", 5, "--dump", tmp_path / "again", "--frames", 3)
    knocked = run(
        "calib-sim",
        *SMALL,
        "--seed",
        5,
        "--dump",
        tmp_path / "knocked",
        "--frames",
        3,
        "--knock-deg",
        "0,0,2",
        "--after-frames",
        1,
    )
    files = sorted(path.relative_to(drive.parent) for path in drive.parent.rglob("*") if path.is_file())
    assert len(files) == 2 + 3 * 3
    for file in files:
        original = (drive.parent / file).read_bytes()
        assert (Path(events(again.stdout)[-1]["drive"]).parent / file).read_bytes() == original
        changed = (Path(events(knocked.stdout)[-1]["drive"]).parent / file).read_bytes() != original
        assert changed == (file.suffix == ".bin" and file.stem != "0000000000")


@pytest.mark.parametrize(
    "camera, size",
    [("fisheye-double-sphere", "160x160"), ("equidistant:60,60,79.5,59.5,0.01,0,0,0", "160x120")],
)
def test_a_camera_of_any_model_is_dumped_with_its_true_depth(tmp_path, camera, size):
    lens = ["--camera", camera, "--size", size]
    done = run("calib-sim", "--lidar-step-deg", 2, "--dump", tmp_path / "out", "--frames", 2, *lens)
    assert done.returncode == 0, done.stderr
    dump = events(done.stdout)[-1]
    assert dump["event"] == "dump"
    recording = Path(dump["recording"]).read_text()
    model = camera.split(":")[0].removeprefix("fisheye-").replace("-", "_")
    assert f"model: {model}, size: [{size.replace('x', ', ')}]" in recording
    truth = events(done.stdout)[0]["T_camera_lidar"]["translation_m"]
    written = json.loads("[" + recording.split("translation_m: [")[1].split("]")[0] + "]")
    assert written == pytest.approx(truth)
    names = ["000000", "000001"]
    assert sorted(path.stem for path in (tmp_path / "out/clouds").iterdir()) == names
    for folder in (tmp_path / "out/images", Path(dump["depth"])):
        assert sorted(path.stem for path in folder.iterdir()) == names
        assert all("x".join(map(str, png_size(path))) == size for path in folder.iterdir())


@pytest.mark.parametrize(
    "arguments, complaint",
    [
        (["--camera", "fisheye-double-sphere"], "--dump"),
        (["--size", "100x100"], "--camera"),
        (["--camera", "no-such-lens", "--dump", "/dev/null/x", "--frames", "1"], "no-such-lens"),
        (["--camera", "eucm:1,2,3", "--size", "64x64", "--dump", "/dev/null/x", "--frames", "1"], "MODEL:fx"),
    ],
)
def test_a_camera_that_is_not_one_is_a_usage_error(arguments, complaint):
    done = run("calib-sim", *arguments)
    assert done.returncode == 2 and complaint in done.stderr and done.stdout == ""


def test_varied_pictures_are_the_same_every_time_and_have_depth(tmp_path):
    for name in ("one", "again"):
        done = run("calib-sim", "--dump", tmp_path / name, "--vary", "--frames", "3", "--seed", "5", "--width", "160",
                   "--height", "64")
        assert done.returncode == 0, done.stderr
    files = sorted(path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*.png"))
    assert [str(path) for path in files] == [f"{kind}/{i:06d}.png" for kind in ("depth", "images") for i in range(3)]
    contents = [(tmp_path / "one" / path).read_bytes() for path in files]
    assert contents == [(tmp_path / "again" / path).read_bytes() for path in files]
    assert len(set(contents)) == 6


@pytest.mark.parametrize("arguments", [["--vary"], ["--vary", "--dump", "x"],
                                       ["--vary", "--dump", "x", "--frames", "1", "--camera", "kitti-360-fisheye"]])
def test_varied_pictures_need_a_folder_and_a_number_and_no_camera(arguments):
    done = run("calib-sim", *arguments)
    assert done.returncode == 2
    assert done.stderr


def test_replay_ends_after_the_last_frame_unless_it_loops(drive):
    once = run("calib-replay", drive, "--domain", DOMAIN, "--fast", "--frames", 10)
    assert events(once.stdout)[-1]["frame"] == 3
    looped = run("calib-replay", drive, "--domain", DOMAIN, "--fast", "--frames", 10, "--loop")
    assert events(looped.stdout)[-1]["frame"] == 10


def test_replay_says_what_is_wrong_with_a_drive(drive, tmp_path):
    missing = run("calib-replay", tmp_path / "nowhere")
    assert missing.returncode == 3 and "nowhere" in missing.stderr
    (tmp_path / "drive").mkdir()
    uncalibrated = run("calib-replay", tmp_path / "drive")
    assert uncalibrated.returncode == 1 and "calib_cam_to_cam.txt" in uncalibrated.stderr


def png_size(path):
    header = path.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", header[16:24])


def test_overlays_differ_where_the_extrinsic_is_wrong(drive, tmp_path):
    for name, arguments in {"right": [], "wrong": ["--knock-deg", "0,0,3"]}.items():
        done = run("calib-replay", drive, "--overlay", tmp_path / f"{name}.png", "--frame", 1, *arguments)
        assert done.returncode == 0, done.stderr
        assert png_size(tmp_path / f"{name}.png") == (320, 96)
    assert (tmp_path / "right.png").read_bytes() != (tmp_path / "wrong.png").read_bytes()
    # Drawn with the extrinsic that the knock has made true, the points are back in place (but for rounding at pixels).
    truth = events(
        run("calib-sim", *SMALL, "--domain", DOMAIN, "--frames", 1, "--knock-deg", "0,0,3").stdout
    )[0]["T_camera_lidar"]
    extrinsic = ",".join(map(repr, truth["translation_m"] + truth["quaternion_xyzw"]))
    done = run(
        "calib-replay",
        drive,
        "--overlay",
        tmp_path / "found.png",
        "--frame",
        1,
        "--knock-deg",
        "0,0,3",
        "--T-camera-lidar",
        extrinsic,
    )
    assert done.returncode == 0, done.stderr
    assert abs(len((tmp_path / "found.png").read_bytes()) - len((tmp_path / "right.png").read_bytes())) < 400

    unwritable = run("calib-replay", drive, "--overlay", tmp_path / "no-folder" / "a.png")
    assert unwritable.returncode == 1 and unwritable.stderr.startswith("write_failed: ")
