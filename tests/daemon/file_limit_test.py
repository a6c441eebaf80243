"""calibd where it may open few files: it ends with a line that says so, and never by a signal."""

import contextlib
import resource
import signal
import subprocess
import time

import pytest

CONFIGURATION = """
vehicle: limited-car
state_dir: {folder}/state
runtime_dir: {folder}/run
signing_key: {folder}/signing.key
dds: {{domain: {domain}, interface: lo}}
sampling: {{period: 1s, window: 200ms}}
pairs:
  - name: front
    camera: {{image: /left, model: rectified, size: [640, 192], intrinsics: [400, 400, 320, 96]}}
    lidar: {{cloud: /points}}
    T_camera_lidar: {{translation_m: [0, 0, 0], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}}
    depth: {{source: stereo, right_image: /right, baseline_m: 0.5}}
"""
LEAST = 3 + 48  # what a program is started with, and what calibd asks for


@pytest.fixture
def start(bin_dir, tmp_path, dds_domain):
    """Starts calibd where it may have so many files open."""
    subprocess.run([bin_dir / "calibctl", "keygen", "--out", tmp_path / "signing.key"], check=True, capture_output=True)
    (tmp_path / "calibd.yaml").write_text(CONFIGURATION.format(folder=tmp_path, domain=dds_domain))
    with contextlib.ExitStack() as stack:
        def run(limit):
            process = stack.enter_context(subprocess.Popen(
                [bin_dir / "calibd", "--config", tmp_path / "calibd.yaml"], text=True,
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
                preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (limit, limit))))
            stack.callback(process.kill)
            return process

        yield run


def test_few_files_are_refused_with_one_line(start, slowdown):
    fewest = 4 if slowdown == 1 else 6  # sanitizers open files of their own
    for limit in [*range(fewest, 24), LEAST - 1]:  # without the check, it would start with 16 and more
        process = start(limit)
        said = process.communicate(timeout=60)[1]
        assert process.returncode == 1, f"limit {limit}: {said}"
        assert len(said.splitlines()) == 1 and f"the limit is {limit}" in said and "LimitNOFILE=" in said, said


def test_with_no_file_at_all_not_even_a_library_is_found(start):
    process = start(3)
    assert "error while loading shared libraries" in process.communicate(timeout=60)[1] and process.returncode == 127


@pytest.mark.parametrize("limit", [LEAST, 64])
def test_enough_files_are_enough(start, tmp_path, slowdown, limit):
    process = start(limit)
    deadline = time.monotonic() + 20 * slowdown
    while not (tmp_path / "run/status.json").exists():
        assert process.poll() is None, process.stderr.read()
        assert time.monotonic() < deadline
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    assert process.wait(20 * slowdown) == 0, process.stderr.read()
