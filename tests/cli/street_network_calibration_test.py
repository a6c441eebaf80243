"""The network that calibd brings finds extrinsics: image, ONNX Runtime, depth, mutual information."""

import json
import subprocess

import pytest


@pytest.fixture
def calibrated(bin_dir, source_dir, tmp_path):
    """The cell of searches from one degree off, with depth from the network."""
    def run(drive, starts):
        file = tmp_path / "result.json"
        subprocess.run([bin_dir / "calib-eval", "calibrate", "--dataset", "kitti-raw", "--root", drive,
                        "--depth", f"onnx:{source_dir}/libcalib/models/street-small.yaml", "--dof", "3",
                        "--rotation-deg", "1", "--starts", str(starts), "--json", file], check=True, timeout=250)
        return json.loads(file.read_text())["cells"][0]
    return run


def test_a_simulated_drive_is_calibrated(bin_dir, tmp_path, calibrated):
    made = subprocess.run([bin_dir / "calib-sim", "--dump", tmp_path, "--frames", "10", "--rate", "0.2"], check=True,
                          capture_output=True, text=True, timeout=120)
    cell = calibrated(json.loads(made.stdout.splitlines()[-1])["drive"], 10)
    assert cell["hit_rate"] >= 0.9
    assert cell["hit_rotation_error_deg"] < 0.35


def test_a_recorded_drive_is_calibrated(kitti_drive, calibrated):
    cell = calibrated(kitti_drive, 20)
    assert cell["hit_rate"] >= 0.9
    assert cell["hit_rotation_error_deg"] < 0.35
