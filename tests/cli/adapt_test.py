"""tools/train/adapt.py on a small simulated drive: the network becomes better on frames that it did not learn from, and what
is written is what calibctl and calib-eval accept. Needs a Python with tools/train/requirements.txt, which tools/setup does
not install: CALIBD_TRAIN_PYTHON names it, and without it the test is skipped, visibly."""

import json
import os
import pathlib
import signal
import subprocess
import types

import pytest

STEPS = 80


@pytest.fixture(scope="module")
def train_python():
    python = os.environ.get("CALIBD_TRAIN_PYTHON")
    if not python:
        pytest.skip("no Python to train with: set CALIBD_TRAIN_PYTHON (tools/train/README.md)")
    return python


@pytest.fixture(scope="module")
def drive(bin_dir, tmp_path_factory):
    made = subprocess.run([bin_dir / "calib-sim", "--dump", tmp_path_factory.mktemp("drive"), "--frames", "40", "--rate", "0.2",
                           "--width", "480", "--height", "144", "--lidar-step-deg", "0.4", "--lidar-fov-deg", "140"],
                          capture_output=True, text=True, check=True, timeout=200)
    return pathlib.Path(json.loads(made.stdout.splitlines()[-1])["drive"])


@pytest.fixture(scope="module")
def command(source_dir, train_python):
    return lambda out, recording, *more: [train_python, source_dir / "tools/train/adapt.py", out, "--recordings", recording,
                                          "--batch", "4", "--every", "10", *map(str, more)]


@pytest.fixture(scope="module")
def adapt(command):
    def run(*arguments):
        ended = subprocess.run(command(*arguments), capture_output=True, text=True, check=False, timeout=1000)
        return types.SimpleNamespace(exit=ended.returncode, out=ended.stdout, err=ended.stderr)
    return run


@pytest.fixture(scope="module")
def adapted(adapt, drive, tmp_path_factory):
    out = tmp_path_factory.mktemp("adapted")
    said = adapt(out, drive, "--steps", STEPS)
    assert said.exit == 0, said.err
    return types.SimpleNamespace(folder=out, said=said, yaml=out / "street-adapted.yaml")


def test_it_agrees_better_with_frames_that_were_held_out(adapted):
    result = json.loads((adapted.folder / "result.json").read_text())
    assert result["better"] and result["mean_gain"] > 0
    assert result["frames"] == [28, 10] and len(result["after"]) == 10
    assert f"step {STEPS} of {STEPS}" in adapted.said.out


def test_what_is_written_is_accepted(adapted, bin_dir, drive):
    checked = subprocess.run([bin_dir / "calibctl", "check-model", adapted.yaml, "--recording", drive, "--frame", "39", "--json"],
                             capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout + checked.stderr
    report = json.loads(checked.stdout)
    assert report["golden_pair"] and report["lidar"]["rank_correlation"] > 0.8
    evaluated = subprocess.run([bin_dir / "calib-eval", "calibrate", "--dataset", "kitti-raw", "--root", drive, "--depth",
                                f"onnx:{adapted.yaml}", "--rotation-deg", "1", "--starts", "5", "--frames", "6"],
                               capture_output=True, text=True, check=False)
    assert evaluated.returncode == 0, evaluated.stderr


def test_a_run_that_was_killed_goes_on_and_ends_with_the_same_network(adapted, command, adapt, drive, tmp_path):
    with subprocess.Popen(command(tmp_path, drive, "--steps", STEPS), stdout=subprocess.PIPE, text=True) as run:
        for line in run.stdout:
            if line.startswith("step 20"):
                run.send_signal(signal.SIGKILL)
                break
    said = adapt(tmp_path, drive, "--steps", STEPS)
    assert said.exit == 0 and "goes on at step" in said.out
    assert (tmp_path / "street-adapted.onnx").read_bytes() == (adapted.folder / "street-adapted.onnx").read_bytes()
    # Of other options the checkpoint is not taken.
    other = adapt(tmp_path, drive, "--steps", STEPS, "--seed", 2)
    assert other.exit == 1 and "give another --out" in other.err


def test_the_right_camera_teaches_too(adapt, drive, tmp_path):
    """By little in so few steps, so that it may not be more than chance yet."""
    adapt(tmp_path, drive, "--steps", STEPS, "--supervision", "stereo")
    assert json.loads((tmp_path / "result.json").read_text())["mean_gain"] > 0.001


def test_what_is_not_better_is_not_written(adapt, drive, tmp_path):
    said = adapt(tmp_path, drive, "--steps", 1, "--rate", 0)
    assert said.exit == 1 and said.err.startswith("adapt.py: ") and "nothing is exported" in said.err
    assert json.loads((tmp_path / "result.json").read_text())["mean_gain"] == 0
    assert not list(tmp_path.glob("*.onnx")) and not list(tmp_path.glob("*.yaml"))


def test_a_list_is_read_as_the_drive_is(adapt, drive, tmp_path):
    def numbers(file, key):
        return [float(number) for line in (drive.parent / file).read_text().splitlines() if line.startswith(key)
                for number in line.split()[1:]]
    P, R, t = numbers("calib_cam_to_cam.txt", "P_rect_02"), numbers("calib_velo_to_cam.txt", "R:"), numbers("calib_velo_to_cam.txt", "T:")
    rows = [[*R[3 * i:3 * i + 3], t[i]] for i in range(3)]
    (tmp_path / "recording.yaml").write_text(
        f"camera: {{model: rectified, size: [480, 144], intrinsics: [{P[0]}, {P[5]}, {P[2]}, {P[6]}]}}\n"
        f"T_camera_lidar: {{matrix: {rows}}}\nimages: {drive}/image_02/data\nclouds: {drive}/velodyne_points/data\n")
    before = []
    for recording in (drive, tmp_path / "recording.yaml"):
        assert adapt(tmp_path / recording.stem, recording, "--steps", 1, "--rate", 0).exit == 1
        before.append(json.loads((tmp_path / recording.stem / "result.json").read_text())["before"])
    assert before[0] == pytest.approx(before[1], abs=1e-4)


@pytest.mark.parametrize("prepare, options, words", [
    (lambda folder: folder / "nowhere", [], "neither a drive of KITTI raw nor the YAML file"),
    (lambda folder: folder, [], "calib_cam_to_cam.txt cannot be read"),
], ids=["no such file", "no calibration"])
def test_what_cannot_be_read_is_said_in_one_line(adapt, tmp_path, prepare, options, words):
    said = adapt(tmp_path / "out", prepare(tmp_path), *options)
    assert said.exit == 1 and words in said.err and said.err.count("\n") == 1
