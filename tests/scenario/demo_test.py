"""The demo does what the first screen of README promises, and fails with a message when a step of it does not happen."""

import os
import pathlib
import re
import signal
import subprocess

import pytest


def demo(source_dir, bin_dir, dds_domain, out, *options):
    return subprocess.run(
        [source_dir / "tools/demo", "--bin-dir", bin_dir, "--out", out, "--domain", str(dds_domain), *options],
        capture_output=True, text=True, timeout=500, check=False)


def check_summary(result, largest_error_deg, out):
    assert result.returncode == 0, result.stdout + result.stderr
    summary = result.stdout[result.stdout.index("== summary"):]
    error_deg = float(re.search(r"recalibrated\s+([\d.]+) degrees", summary).group(1))
    assert error_deg <= largest_error_deg, summary
    assert re.search(r"record\s+\d+, signed by [0-9A-F]{16}, verified", summary)
    picture = out / "before-after.png"
    assert re.search(rf"picture\s+{re.escape(str(picture))}\n", summary)
    header = picture.read_bytes()[:24]
    assert header.startswith(b"\x89PNG\r\n\x1a\n")
    width, height = (int.from_bytes(header[at:at + 4], "big") for at in (16, 20))
    assert width >= 1200 and height >= 600, "two halves, each enlarged"


@pytest.mark.parametrize("depth", ["stereo", "network"])
def test_a_knock_of_the_simulated_vehicle_is_found_and_corrected(source_dir, bin_dir, dds_domain, tmp_path, depth):
    check_summary(demo(source_dir, bin_dir, dds_domain, tmp_path, "--depth", depth), 0.2, tmp_path)


def test_a_knock_of_the_recorded_vehicle_is_found_and_corrected(source_dir, bin_dir, dds_domain, tmp_path, kitti_drive):
    check_summary(demo(source_dir, bin_dir, dds_domain, tmp_path, "--kitti", kitti_drive), 0.35, tmp_path)


def test_a_daemon_that_ends_fails_the_demo_with_its_error_output(source_dir, bin_dir, dds_domain, tmp_path):
    programs = tmp_path / "bin"
    programs.mkdir()
    for name in ("calibctl", "calib-sim"):
        (programs / name).symlink_to(bin_dir / name)
    (programs / "calibd").write_text("#!/bin/sh\necho the sky is falling >&2\nexit 1\n")
    (programs / "calibd").chmod(0o755)
    result = demo(source_dir, programs, dds_domain, tmp_path)
    assert result.returncode == 1
    assert "calibd ended with 1" in result.stderr and "the sky is falling" in result.stderr


@pytest.mark.parametrize("ended_by", [signal.SIGTERM, signal.SIGINT])
def test_an_interrupted_demo_leaves_no_process_and_no_folder(source_dir, bin_dir, dds_domain, tmp_path, ended_by):
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    process = subprocess.Popen(
        [source_dir / "tools/demo", "--bin-dir", bin_dir, "--out", tmp_path / "out", "--domain", str(dds_domain)],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env={**os.environ, "TMPDIR": str(temporary)})
    for line in process.stdout:  # until it has started its programs and heard from them
        if "not_evaluated" in line:
            break
    children = pathlib.Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
    assert len(children) >= 2
    process.send_signal(ended_by)
    assert process.wait(30) == 128 + ended_by
    assert not [pid for pid in children if os.path.exists(f"/proc/{pid}")]
    assert not list(temporary.iterdir())
