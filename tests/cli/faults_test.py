"""What the real calibd leaves when it is killed at any moment, and what it says when its disk fails: no record that was
acknowledged is lost, no chain is broken, and each fault has a name in the status."""

import contextlib
import json
import os
import random
import re
import signal
import socket
import subprocess
import threading
import time

import pytest

from conftest import DONE, FAILED
from daemon_test import configuration  # noqa: F401: a fixture
from keys_test import Vehicle, vehicle  # noqa: F401: a fixture

KILLS = int(os.environ.get("CALIBD_KILLS", "12"))


def ask(vehicle, request, file=None):  # noqa: F811
    with socket.socket(socket.AF_UNIX) as client:
        client.settimeout(20)
        client.connect(str(vehicle.calibctl.socket))
        line = json.dumps({"schema": 1, **request}).encode() + b"\n"
        if file is None:
            client.sendall(line)
        else:
            socket.send_fds(client, [line], [file])
        reply = client.makefile().readline()
        return json.loads(reply) if reply else None


class Asker(threading.Thread):
    """Has records written, one after the other, and notes those that calibd has acknowledged."""

    def __init__(self, vehicle, next_key):  # noqa: F811
        super().__init__(daemon=True)
        self.vehicle, self.next_key, self.acknowledged, self.rotated = vehicle, next_key, 0, False

    def run(self):
        with contextlib.suppress(OSError, ValueError):
            for number in range(1000):
                rotates = self.next_key is not None and number == 2
                if rotates:
                    with open(self.next_key, "rb") as file:
                        reply = ask(self.vehicle, {"request": "rotate_key"}, file.fileno())
                else:
                    reply = ask(self.vehicle, {"request": "rollback", "pair": "front", "to": 1, "comment": f"number {number}"})
                if reply is None:
                    return
                assert reply["ok"], reply
                self.acknowledged = reply["record"]
                self.rotated = self.rotated or rotates


def start_ready(vehicle):  # noqa: F811
    """As `start`, without a process of calibctl for each question."""
    with open(vehicle.folder / "log", "wb") as log:
        vehicle.running = subprocess.Popen(vehicle.command, stderr=log)
    deadline = time.monotonic() + 30
    while True:
        with contextlib.suppress(OSError):
            reply = ask(vehicle, {"request": "status"})
            if reply is not None:
                return reply["status"]
        assert vehicle.running.poll() is None and time.monotonic() < deadline, vehicle.log()
        time.sleep(0.01)


def test_no_acknowledged_record_is_lost_by_kill_9(vehicle):  # noqa: F811
    """CALIBD_KILLS sets the number of kills."""
    lots = random.Random(3)
    public_keys = [vehicle.calibctl.public_key.read_bytes()]
    acknowledged, keys = 1, 0
    for number in range(KILLS):
        next_key = None
        if number % 6 == 5:
            keys += 1
            next_key = vehicle.folder / f"rotated{keys}.key"
            assert vehicle.calibctl("keygen", "--out", next_key).exit == DONE
        asker = Asker(vehicle, next_key)
        asker.start()
        time.sleep(lots.uniform(0, 0.5))
        vehicle.stop(signal.SIGKILL)
        asker.join(20)
        assert not asker.is_alive()
        acknowledged = max(acknowledged, asker.acknowledged)

        status = start_ready(vehicle)
        if status["records"]["signing_refused"] is not None or asker.rotated:
            # The record of the change was written; its key has to be put in place, whether or not anybody was told.
            assert next_key is not None and status["records"]["signing_refused"] is not None
            vehicle.stop()
            next_key.rename(vehicle.calibctl.key)
            public_keys.append(next_key.with_suffix(".pub").read_bytes())
            status = start_ready(vehicle)
        assert status["records"] == {"missing": None, "signing_refused": None}, f"kill {number}"
        if number % 10 == 0 or number == KILLS - 1:
            verified = vehicle.calibctl("verify")
            assert verified.exit == DONE, verified.err
            assert int(verified.out.split()[0]) >= acknowledged
        assert status["pairs"][0]["record"]["sequence"] >= acknowledged - 1, "one of them may be a change of keys"
        assert "set aside" not in vehicle.log()
    print(f"{KILLS} kills, {acknowledged} records acknowledged, {len(public_keys)} keys")
    assert acknowledged > KILLS // 2


@contextlib.contextmanager
def own_disk(folder, size):
    folder.mkdir(exist_ok=True)
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size},mode=755", "tmpfs", folder],
                             capture_output=True, check=False)
    if mounted.returncode != 0:
        pytest.skip("needs the right to mount a file system")
    try:
        yield
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


@pytest.fixture
def on_own_disk(bare, bin_dir, configuration):  # noqa: F811
    """A vehicle whose state folder is a file system of 3 MB."""
    state = bare.folder / "state"
    with own_disk(state, "3m"):
        configuration.write_text(re.sub(r"(?m)^state_dir:.*$", f"state_dir: {state}", configuration.read_text()))
        bare.store = state / "calibd.db"
        bare.command = lambda *arguments: [bare.program, "--socket", bare.socket, "--state-dir", state, "--public-key",
                                           bare.public_key, *arguments]
        made = Vehicle(bare, bin_dir, configuration)
        start_ready(made)
        yield made, state
        made.running.kill()
        made.running.wait()


def test_a_full_disk_is_a_state_with_a_name_and_passes(on_own_disk):
    vehicle, state = on_own_disk  # noqa: F811
    calibctl = vehicle.calibctl
    assert calibctl("rollback", "front", "--to", "1", "--comment", "before").exit == DONE
    with contextlib.suppress(OSError), open(state / "filler", "wb", buffering=0) as filler:
        while True:
            filler.write(b"x" * 4096)
    refused = calibctl("rollback", "front", "--to", "1", "--comment", "x" * 1000)
    assert refused.exit == FAILED and "could not be written" in refused.err, refused
    assert calibctl("rotate-key", vehicle.folder / "next.key").exit == FAILED
    pair, = vehicle.status()["pairs"]
    assert pair["verdict"] == "not_evaluated" and pair["cause"] == "store_failed", pair
    assert calibctl("verify").out.startswith("2 records verified")
    (state / "filler").unlink()
    deadline = time.monotonic() + 20
    while calibctl("rollback", "front", "--to", "1").exit != DONE:
        assert time.monotonic() < deadline
        time.sleep(0.2)
    vehicle.stop(signal.SIGKILL)
    assert start_ready(vehicle)["records"] == {"missing": None, "signing_refused": None}
    assert calibctl("verify").out.startswith("3 records verified")


def test_a_start_on_a_read_only_disk_says_so_and_leaves_the_records(on_own_disk):
    vehicle, state = on_own_disk  # noqa: F811
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE
    vehicle.stop()
    subprocess.run(["mount", "-o", "remount,ro", state], check=True)
    refused = subprocess.run(vehicle.command, capture_output=True, text=True, timeout=30, check=False)
    assert refused.returncode == 78 and f"{state} cannot be written" in refused.stderr, refused
    assert vehicle.calibctl("verify").out.startswith("2 records verified")
    subprocess.run(["mount", "-o", "remount,rw", state], check=True)
    assert start_ready(vehicle)["records"] == {"missing": None, "signing_refused": None}
