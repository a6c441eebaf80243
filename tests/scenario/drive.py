"""A drive: a vehicle of tools/ that publishes on loopback, and calibd that watches it. Tests say the physics and the bounds."""

import itertools
import json
import math
import signal
import subprocess
import time

RATE_HZ = 2


def difference(a, b):
    """Angle (degrees) and distance (cm) between two transforms, however their quaternions are signed."""
    x, y, z, w = a["quaternion_xyzw"]
    i, j, k, r = b["quaternion_xyzw"]
    vector = (w * i - x * r - y * k + z * j, w * j + x * k - y * r - z * i, w * k - x * j + y * i - z * r)
    scalar = w * r + x * i + y * j + z * k
    angle = 2 * math.atan2(math.hypot(*vector), abs(scalar))
    return math.degrees(angle), 100 * math.dist(a["translation_m"], b["translation_m"])


class Drive:
    """`vehicle` is the program with what it shall do; both programs end, by process id, with the `with` block."""

    def __init__(self, bin_dir, folder, domain, *vehicle, configure=lambda text: text, rate_hz=RATE_HZ):
        self.bin, self.folder = bin_dir, folder
        self.vehicle_words = [str(word) for word in vehicle]
        self.domain, self.rate_hz = domain, rate_hz
        self.config = folder / "calibd.yaml"
        pairs = subprocess.run([*self.vehicle_command(), "--print-config"], capture_output=True, text=True, check=True).stdout
        self.config.write_text(configure(
            f"vehicle: scenario-car\nstate_dir: {folder}/state\nruntime_dir: {folder}/run\n"
            f"dds: {{domain: {domain}, interface: lo}}\nsigning_key: {folder}/signing.key\n"
            "sampling: {period: 500ms, window: 500ms, max_time_difference: 50ms}\n" + pairs))
        self.ctl("keygen", "--out", folder / "signing.key")
        self.vehicle = self.calibd = None

    def vehicle_command(self):
        return [self.bin / self.vehicle_words[0], *self.vehicle_words[1:]]

    def __enter__(self):
        self.start_calibd()
        with (self.folder / "truth.jsonl").open("wb") as truth:
            self.vehicle = subprocess.Popen([*self.vehicle_command(), "--rate", str(self.rate_hz), "--domain", str(self.domain)],
                                            stdout=truth)
        self.wait_for(lambda _: self.truth_lines(), 30)
        return self

    def start_calibd(self):
        with (self.folder / "calibd.log").open("ab") as log:
            self.calibd = subprocess.Popen([self.bin / "calibd", "--config", self.config], stderr=log)

    def kill_calibd(self):
        self.calibd.kill()
        self.calibd.wait(10)

    def __exit__(self, *_):
        for process in (self.vehicle, self.calibd):
            process.send_signal(signal.SIGTERM)
        assert [self.vehicle.wait(30), self.calibd.wait(30)] == [0, 0], self.log()

    def ctl(self, *words):
        return subprocess.run([self.bin / "calibctl", "--socket", self.folder / "run/control.sock", "--state-dir",
                               self.folder / "state", "--public-key", self.folder / "signing.pub", *map(str, words)],
                              capture_output=True, text=True, timeout=60, check=False)

    def log(self):
        return (self.folder / "calibd.log").read_text(errors="replace")

    def pairs(self):
        """As calibd tells them; nothing while calibd does not answer."""
        done = self.ctl("status", "--json")
        status = json.loads(done.stdout) if done.returncode == 0 else None
        return status["pairs"] if status and status["daemon"]["running"] else None

    def status(self):
        """The first pair."""
        pairs = self.pairs()
        return pairs[0] if pairs else None

    def truth_lines(self):
        return [json.loads(line) for line in (self.folder / "truth.jsonl").read_text().splitlines()]

    def truth(self):
        """Where the LiDAR is, as the vehicle last said, and whether it was knocked."""
        last = self.truth_lines()[-1]
        return last["T_camera_lidar"], any(last["knock_deg"]) or any(last["knock_cm"])

    def wait_for(self, condition, seconds):
        """The first status for which `condition` holds; fails, with calibd's log, when none comes in time."""
        end = time.monotonic() + seconds
        while True:
            status = self.status()
            if status and condition(status):
                return status
            assert self.calibd.poll() is None and self.vehicle.poll() is None, self.log()
            assert time.monotonic() < end, f"{status}\n{self.log()}"
            time.sleep(0.1)

    def wait_for_knock(self, seconds):
        end = time.monotonic() + seconds
        while not self.truth()[1]:
            assert time.monotonic() < end, self.log()
            time.sleep(0.05)
        return self.status()

    def verdicts(self):
        """What calibd said of the extrinsic, in turn. Windows that a slow machine missed (`not_evaluated`) say nothing of it."""
        words = ("calibrated", "suspect", "drifted")
        said = [word for line in self.log().splitlines() for word in words if f": {word} (was" in line]
        return [word for word, _ in itertools.groupby(said)]

    def knocked_and_corrected(self, largest_error_deg, most_pairs_to_drift):
        """From the knock on: `drifted` in time, then one accepted record near the truth; its error in degrees."""
        before = self.wait_for_knock(200)
        assert before["verdict"] == "calibrated" and before["record"]["sequence"] == 1, self.log()
        drifted = self.wait_for(lambda pair: pair["verdict"] == "drifted", 60)
        # One pair may have been on its way through the pipeline when the knock was heard of.
        assert drifted["evaluated"] - before["evaluated"] <= most_pairs_to_drift + 1, self.log()
        after = self.wait_for(lambda pair: pair["record"]["sequence"] > 1, 120)
        error_deg, _ = difference(after["T_camera_lidar"], self.truth()[0])
        assert error_deg <= largest_error_deg, self.log()
        verified = self.ctl("verify")
        assert verified.returncode == 0, verified.stdout + verified.stderr
        return error_deg
