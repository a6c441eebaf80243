"""calibd under test, and a vehicle for it that drives past `scene.Street`, knows no code of calibd's and can be knocked."""

import contextlib
import json
import os
import subprocess
import threading
import time

import numpy as np
import ros
import scene

LEFT, RIGHT, CLOUD = "/camera/left/image", "/camera/right/image", "/lidar/points"


def image_message(stamp_ns, pixels):
    return ros.message("sensor_msgs/Image", header=ros.header(stamp_ns, "camera"), height=pixels.shape[0],
                       width=pixels.shape[1], encoding="mono8", is_bigendian=0, step=pixels.shape[1],
                       data=pixels.reshape(-1))


def cloud_message(stamp_ns, points):
    fields = [ros.message("sensor_msgs/PointField", name=name, offset=4 * i, datatype=7, count=1)
              for i, name in enumerate(["x", "y", "z", "intensity"])]
    return ros.message("sensor_msgs/PointCloud2", header=ros.header(stamp_ns, "lidar"), height=1, width=len(points),
                       fields=fields, is_bigendian=False, point_step=16, row_step=16 * len(points),
                       data=points.view(np.uint8).reshape(-1), is_dense=True)


def render(count, step_m=1.3):
    street = scene.Street()
    return [street.frame(step_m * i) for i in range(count)]


class Vehicle:
    """Publishes `frames` in a loop, left image, right image and scan with one stamp, from a thread of its own."""

    def __init__(self, peer, frames, rate_hz=6):
        self._frames, self._period = frames, 1 / rate_hz
        self.left, self._right = peer.writer(ros.Image, LEFT), peer.writer(ros.Image, RIGHT)
        self._cloud = peer.writer(ros.PointCloud2, CLOUD, reliable=False)
        self.knock = (0, 0, 0)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._drive)

    def _drive(self):
        i = 0
        while not self._stop.wait(self._period):
            left, right, points = self._frames[i % len(self._frames)]
            stamp = time.time_ns()
            ros.write_cdr(self.left, ros.cdr("sensor_msgs/Image", image_message(stamp, left)))
            ros.write_cdr(self._right, ros.cdr("sensor_msgs/Image", image_message(stamp, right)))
            points = scene.knocked(points, *self.knock)
            ros.write_cdr(self._cloud, ros.cdr("sensor_msgs/PointCloud2", cloud_message(stamp, points)))
            i += 1

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()


def configuration(folder, domain, period="300ms", window="300ms"):
    return {
        "vehicle": "interop-car", "state_dir": str(folder / "state"), "runtime_dir": str(folder / "run"),
        "dds": {"domain": domain, "interface": "lo"}, "signing_key": str(folder / "signing.key"),
        "sampling": {"period": period, "window": window, "max_time_difference": "50ms"},
        "pairs": [{
            "name": "front",
            "camera": {"image": LEFT, "model": "rectified", "size": [scene.WIDTH, scene.HEIGHT],
                       "intrinsics": scene.INTRINSICS, "frame_id": "camera"},
            "lidar": {"cloud": CLOUD, "frame_id": "lidar"},
            "T_camera_lidar": {"translation_m": list(scene.LIDAR_IN_CAMERA),
                               "quaternion_xyzw": scene.quaternion_xyzw(scene.R_CAMERA_LIDAR).tolist()},
            "depth": {"source": "stereo", "right_image": RIGHT, "baseline_m": scene.BASELINE_M},
            "drift": {"baseline_pairs": 8},
            "recalibration": {"mode": "propose", "frames": 12, "max_rotation_deg": 5, "max_translation_cm": 50},
        }]}


class Calibd:
    """The daemon, and what it says of its pairs through calibctl."""

    # What is freed must not be kept for AddressSanitizer's sake: memory is measured here.
    ENVIRONMENT = os.environ | {"ASAN_OPTIONS": os.environ.get("ASAN_OPTIONS", "") + ":quarantine_size_mb=1"}

    def __init__(self, bin_dir, folder, config):
        self._bin, self._socket, self._file = bin_dir, folder / "run" / "control.sock", folder / "calibd.yaml"
        self._file.write_text(json.dumps(config, indent=1))  # JSON is YAML
        subprocess.run([bin_dir / "calibctl", "keygen", "--out", folder / "signing.key"], check=True, capture_output=True)
        self._log = folder / "calibd.log"

    def __enter__(self):
        with self._log.open("wb") as log:
            self._daemon = subprocess.Popen([self._bin / "calibd", "--config", self._file], stderr=log,
                                            env=self.ENVIRONMENT)
        self.wait_for(lambda: self._socket.exists(), 30)
        return self

    def __exit__(self, *_):
        self.stop()

    def log(self):
        return self._log.read_text(errors="replace")

    def alive(self):
        return self._daemon.poll() is None

    def resident_bytes(self):
        with open(f"/proc/{self._daemon.pid}/statm") as statm:
            return int(statm.read().split()[1]) * 4096

    def peak_bytes(self):
        with open(f"/proc/{self._daemon.pid}/status") as status:
            return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmHWM"))

    def pid(self):
        return self._daemon.pid

    def stop(self):
        """As systemd does; returns once it has ended."""
        self._daemon.terminate()
        assert self._daemon.wait(timeout=30) == 0, self.log()

    def pairs(self):
        done = subprocess.run([self._bin / "calibctl", "--socket", self._socket, "status", "--json"],
                              capture_output=True, text=True, timeout=30)
        assert done.returncode == 0, done.stderr + self.log()
        status = json.loads(done.stdout)
        assert status["daemon"]["running"]
        return {pair["name"]: pair for pair in status["pairs"]}

    def pair(self):
        return self.pairs()["front"]

    def wait_for(self, condition, seconds):
        """Fails, with the daemon's log, when `condition` does not come true in time."""
        end = time.monotonic() + seconds
        while not condition():
            assert self.alive(), self.log()
            assert time.monotonic() < end, self.log()
            time.sleep(0.1)


@contextlib.contextmanager
def calibrated(bin_dir, folder, domain, peer, frames):
    """A daemon that has learned its baseline, and the vehicle it watches."""
    with Calibd(bin_dir, folder, configuration(folder, domain)) as daemon, Vehicle(peer, frames) as car:
        daemon.wait_for(lambda: daemon.pair()["verdict"] == "calibrated", 120)
        yield daemon, car
