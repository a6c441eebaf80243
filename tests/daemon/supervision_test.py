"""calibd as a service manager sees it: what it notifies, how it ends, and with which code."""

import contextlib
import signal
import socket
import subprocess

import pytest

CONFIGURATION = """
vehicle: supervised-car
dds: {{domain: {domain}, interface: lo}}
signing_key: {folder}/signing.key
sampling: {{period: 1s, window: 200ms}}
pairs:
  - name: front
    camera: {{image: /left, model: rectified, size: [640, 192], intrinsics: [400, 400, 320, 96]}}
    lidar: {{cloud: /points}}
    T_camera_lidar: {{translation_m: [0, 0, 0], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}}
    depth: {{source: stereo, right_image: /right, baseline_m: 0.5}}
"""


@pytest.fixture
def start(bin_dir, tmp_path, dds_domain):
    """Starts calibd with the folders and the notification socket that a unit would give it."""
    subprocess.run([bin_dir / "calibctl", "keygen", "--out", tmp_path / "signing.key"], check=True, capture_output=True)
    (tmp_path / "calibd.yaml").write_text(CONFIGURATION.format(domain=dds_domain, folder=tmp_path))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager, contextlib.ExitStack() as stack:
        manager.bind(str(tmp_path / "notify"))
        manager.settimeout(20)
        environment = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "STATE_DIRECTORY": str(tmp_path / "state"),
                       "RUNTIME_DIRECTORY": str(tmp_path / "run")}

        def run(*options):
            process = stack.enter_context(subprocess.Popen(
                [bin_dir / "calibd", "--config", tmp_path / "calibd.yaml", *options], env=environment, text=True,
                stdout=subprocess.PIPE, stderr=subprocess.PIPE))
            stack.callback(process.kill)
            return process, manager

        yield run


def heard_until(manager, word):
    heard = []
    while not heard or word not in heard[-1]:
        heard.append(manager.recv(4096).decode())
    return heard


@pytest.mark.parametrize("signal_sent", [signal.SIGTERM, signal.SIGINT])
def test_readiness_life_and_end_are_notified(start, tmp_path, signal_sent):
    process, manager = start()
    assert heard_until(manager, "READY=1")
    for _ in range(4):  # the pipeline goes round, though every sensor is silent
        heard_until(manager, "WATCHDOG=1")
    assert (tmp_path / "run/control.sock").exists()
    process.send_signal(signal_sent)
    heard_until(manager, "STOPPING=1")
    assert process.wait(10) == 0
    assert not (tmp_path / "run/control.sock").exists() and (tmp_path / "run/status.json").exists()


@pytest.mark.parametrize("break_it, words", [
    (lambda folder: (folder / "calibd.yaml").write_text("vehicle: car\nvehicel: car\n"), "calibd.yaml:2: vehicel"),
    (lambda folder: (folder / "calibd.yaml").unlink(), "calibd.yaml"),
    (lambda folder: (folder / "signing.key").unlink(), "calibctl keygen"),
    (lambda folder: (folder / "signing.key").chmod(0o644), "signing.key"),
], ids=["unknown key", "no configuration", "no key", "open key"])
def test_what_starting_again_cannot_mend_ends_with_78_and_one_line(start, tmp_path, break_it, words):
    break_it(tmp_path)
    process, _ = start()
    assert process.wait(20) == 78
    lines = process.stderr.read().splitlines()
    assert len(lines) == 1 and words in lines[0]


def test_a_second_daemon_on_the_same_folder_is_refused(start):
    first, manager = start()
    heard_until(manager, "READY=1")
    second, _ = start()
    assert second.wait(20) == 1
    assert "another calibd" in second.stderr.read()
    first.terminate()
    assert first.wait(10) == 0
