"""What goes wrong around calibd, and what it says then: on its log, in its status, and in `calibctl events`."""

import contextlib
import hashlib
import json
import os
import signal
import socket
import subprocess
import threading
import time

import pytest

from supervision_test import heard_until, start  # noqa: F401, a fixture


class Ctl:
    def __init__(self, bin_dir, folder, state):
        self.command = [bin_dir / "calibctl", "--socket", folder / "run/control.sock", "--state-dir", state, "--public-key",
                        folder / "signing.pub"]
        self.no_journal = ["--journal", folder]

    def __call__(self, *arguments):
        return subprocess.run([*self.command, *arguments], capture_output=True, text=True, check=False, timeout=60)


@pytest.fixture
def ctl(bin_dir, tmp_path):
    return Ctl(bin_dir, tmp_path, tmp_path / "state")


def change(tmp_path, what, instead):
    file = tmp_path / "calibd.yaml"
    text = file.read_text()
    assert what in text
    file.write_text(text.replace(what, instead))


def drain(manager):
    """Notifications that nobody reads would stop calibd."""
    with contextlib.suppress(OSError):
        while True:
            manager.recv(4096)


def ended(process, patience=20):
    code = process.wait(patience)
    return code, process.stderr.read().splitlines()


def test_a_wrong_topic_is_told_after_a_minute_with_the_one_that_is_meant(start, ctl, tmp_path, bin_dir, dds_domain):
    change(tmp_path, "/left", "/camera/left/imag")
    vehicle = subprocess.Popen([bin_dir / "calib-sim", "--domain", str(dds_domain), "--interface", "lo", "--rate", "2"],
                               stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        began = time.monotonic()
        process, manager = start()
        heard_until(manager, "READY=1")
        told = "nobody publishes /camera/left/imag: the topic is probably /camera/left/image"
        threading.Thread(target=drain, args=(manager,), daemon=True).start()
        line = next(line for line in process.stderr if "no evidence for" in line)
        assert 55 < time.monotonic() - began < 75
        assert "front: no evidence for 6" in line and told in line and "write /camera/left/image as camera.image" in line
        assert told in " ".join(ctl("status", "front").stdout.replace("\n" + 16 * " " + ": ", " ").split())
        events = ctl("events", *ctl.no_journal).stdout
        assert "not_evaluated  alert" in events and told in " ".join(events.split())
    finally:
        vehicle.kill()
        vehicle.wait()


def test_another_extrinsic_in_the_configuration_is_told_at_the_start(start, ctl, tmp_path):
    process, manager = start()
    heard_until(manager, "READY=1")
    process.terminate()
    _, lines = ended(process)
    assert not any("another extrinsic" in line for line in lines), "the first one is no change"
    change(tmp_path, "translation_m: [0, 0, 0]", "translation_m: [0, 0, 0.03]")
    process, manager = start()
    heard_until(manager, "READY=1")
    events = " ".join(ctl("events", *ctl.no_journal).stdout.split())
    assert "the configuration has another extrinsic than before: it is in force by record 2, 0.00 degrees and 3.0 cm" in events
    process.terminate()
    _, lines = ended(process)
    assert sum("another extrinsic than before" in line for line in lines) == 1


@pytest.fixture
def small_disk(tmp_path):
    """A file system of 4 MiB for the state folder, which can be filled and freed."""
    state = tmp_path / "state"
    state.mkdir()
    if os.geteuid() != 0 or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=4M", "tmpfs", state], check=False).returncode != 0:
        pytest.skip("a file system can be mounted by root only")
    yield state
    subprocess.run(["umount", "--lazy", state], check=True)


def test_a_full_disk_is_told_at_once_and_so_is_its_end(start, ctl, small_disk):
    process, manager = start()
    heard_until(manager, "READY=1")
    filler = small_disk / "filler"
    try:
        with open(filler, "wb") as file:
            while True:
                file.write(b"x" * 4096)
                file.flush()
    except OSError:
        pass
    full = time.monotonic()
    shown = heard_until(manager, "evidence is lost")[-1]
    assert "is full: 0 KiB are free; evidence is lost until it can be written again" in shown
    assert time.monotonic() - full < 5, "the period is a second"
    assert "store_failed" in ctl("status").stdout
    filler.unlink()
    heard_until(manager, "sensor_silent")
    assert ctl("verify").returncode == 0
    process.terminate()
    code, lines = ended(process)
    assert code == 0
    assert [("is full" in line, "can be written again" in line) for line in lines if "disk" in line or "again" in line] == [
        (True, False), (False, True)], lines


def test_an_interface_that_does_not_exist_is_named(start, tmp_path, bin_dir):
    change(tmp_path, "interface: lo", "interface: nosuch0")
    code, lines = ended(start()[0])
    assert code == 1 and "dds.interface: there is no network interface nosuch0; there are: lo (127.0.0.1)" in lines[-1]
    checked = subprocess.run([bin_dir / "calibd", "--check-config", "--config", tmp_path / "calibd.yaml"], capture_output=True,
                             text=True, env={"STATE_DIRECTORY": "/s", "RUNTIME_DIRECTORY": "/r"}, check=False)
    assert checked.returncode == 0 and "warning: dds.interface: there is no network interface nosuch0" in checked.stdout


def test_a_port_that_is_in_use_is_named_and_a_calibd_that_runs_is_no_obstacle(start, tmp_path, bin_dir, dds_domain):
    check = [bin_dir / "calibd", "--check-config", "--config", tmp_path / "calibd.yaml"]
    environment = {"STATE_DIRECTORY": "/s", "RUNTIME_DIRECTORY": "/r"}
    port = 7400 + 250 * dds_domain
    process, manager = start()
    heard_until(manager, "READY=1")
    checked = subprocess.run(check, capture_output=True, text=True, env=environment, check=True)
    assert "warning" not in checked.stdout
    process.terminate()
    assert process.wait(10) == 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("", port))
        code, lines = ended(start()[0])
        assert code == 1 and f"dds.domain: UDP port {port} of domain {dds_domain} is in use" in lines[-1]
        checked = subprocess.run(check, capture_output=True, text=True, env=environment, check=True)
        assert f"warning: dds.domain: UDP port {port}" in checked.stdout


def test_reload_and_sighup_say_what_they_do(start, ctl, tmp_path):
    process, manager = start()
    heard_until(manager, "READY=1")
    change(tmp_path, "period: 1s", "period: 500ms")
    done = ctl("reload", "--json")
    assert done.returncode == 0 and '"sampling.period"' in done.stdout
    notified = "\n".join(heard_until(manager, "READY=1"))
    assert "RELOADING=1\nMONOTONIC_USEC=" in notified
    change(tmp_path, "vehicle:", "vehikel:")
    process.send_signal(signal.SIGHUP)
    assert "calibd.yaml:2: vehikel" in heard_until(manager, "not reloaded")[-1]
    refused = ctl("reload")
    assert refused.returncode == 1 and "calibd.yaml:2: vehikel" in refused.stderr and "stays in force" in refused.stderr
    change(tmp_path, "vehikel:", "vehicle:")
    assert ctl("reload").returncode == 0
    assert ctl("rollback", "front", "--to", "1").returncode == 0
    record = json.loads(ctl("show", "--json").stdout)
    assert record["configuration_sha256"] == hashlib.sha256((tmp_path / "calibd.yaml").read_bytes()).hexdigest()
    process.terminate()
    assert process.wait(10) == 0
