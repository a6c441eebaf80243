"""Whatever a peer sends: calibd counts it under its reason, lives, keeps its memory, and evaluates the next good pair."""

import copy
import dataclasses
import pathlib
import re
import socket
import time
import zlib

import numpy as np
import pytest

pytest.importorskip("cyclonedds", reason="no cyclonedds package for this machine")
from cyclonedds.idl import IdlStruct  # noqa: E402
from cyclonedds.idl.types import sequence, uint8  # noqa: E402

import ros  # noqa: E402
import scene  # noqa: E402
import vehicle  # noqa: E402

IMAGE, CLOUD = "sensor_msgs/Image", "sensor_msgs/PointCloud2"
COMPRESSED, INFO, IMU = "sensor_msgs/CompressedImage", "sensor_msgs/CameraInfo", "sensor_msgs/Imu"
# The front pair reads raw images; the rear one, which nobody drives, compressed ones and an IMU.
TOPICS = {IMAGE: (ros.Image, vehicle.LEFT), CLOUD: (ros.PointCloud2, vehicle.CLOUD),
          INFO: (ros.CameraInfo, "/camera/left/camera_info"),
          COMPRESSED: (ros.CompressedImage, "/rear/left/compressed"), IMU: (ros.Imu, "/imu/data")}
POINTS = np.ones((6, 4), np.float32)
PIXELS = np.full((4, 6), 7, np.uint8)


def image(**changes):
    return ros.cdr(IMAGE, dataclasses.replace(vehicle.image_message(1, PIXELS), **changes))


def cloud(**changes):
    return ros.cdr(CLOUD, dataclasses.replace(vehicle.cloud_message(1, POINTS), **changes))


def compressed(data, format="png"):
    return ros.cdr(COMPRESSED, ros.message("sensor_msgs/CompressedImage", header=ros.header(1, "camera"), format=format,
                                           data=np.frombuffer(data, np.uint8)))


def png(width, height, pixels=b"\0" * 9):
    """A PNG with this header and, unless they are given, hardly any pixels."""
    def chunk(kind, body):
        return len(body).to_bytes(4, "big") + kind + body + zlib.crc32(kind + body).to_bytes(4, "big")

    head = width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\x00\x00\x00\x00"
    return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(pixels, 9))
            + chunk(b"IEND", b""))


def jpeg_of_scans(width, height, scans):
    """A progressive JPEG of one colour, whose refinements have no data: a decoder goes over all of it for each of them."""
    table = b"".join(b"\xff\xc4\0\x14" + kind + b"\1" + bytes(16) for kind in (b"\0", b"\x10"))
    frame = (b"\xff\xc2\0\x0b\x08" + height.to_bytes(2, "big") + width.to_bytes(2, "big") + b"\1\1\x11\0")
    first, refinement = b"\xff\xda\0\x08\1\1\0\0\0\1\0\0\0\0", b"\xff\xda\0\x08\1\1\0\1\x3f\x10\0"
    return (b"\xff\xd8\xff\xdb\0\x43\0" + b"\1" * 64 + frame + table + first + refinement * (scans - 1) + b"\xff\xd9")


SCANS_BOMB = jpeg_of_scans(8000, 8000, 600)
PIXELS_BOMB = png(8000, 8000, bytes(8001 * 8000))


def info(**changes):
    roi = ros.message("sensor_msgs/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
    good = ros.message(INFO, header=ros.header(1, "camera"), height=4, width=6, distortion_model="plumb_bob",
                       d=np.zeros(5), k=np.array([9, 0, 3, 0, 9, 2, 0, 0, 1], float), r=np.zeros(9), p=np.zeros(12),
                       binning_x=0, binning_y=0, roi=roi)
    return ros.cdr(INFO, dataclasses.replace(good, **changes))


def imu(turn=0.0, first_covariance=0.0, **changes):
    def vector(z):
        return ros.message("geometry_msgs/Vector3", x=0.0, y=0.0, z=z)

    good = ros.message(IMU, header=ros.header(1, "imu"), angular_velocity=vector(turn), linear_acceleration=vector(9.8),
                       orientation=ros.message("geometry_msgs/Quaternion", x=0.0, y=0.0, z=0.0, w=1.0),
                       orientation_covariance=np.zeros(9), linear_acceleration_covariance=np.zeros(9),
                       angular_velocity_covariance=np.array([first_covariance] + [0.0] * 8))
    return ros.cdr(IMU, dataclasses.replace(good, **changes))


def with_focal_length(f):
    return np.array([f, 0, 3, 0, f, 2, 0, 0, 1], float)


def fields(**changes):
    """The cloud's fields, with the last one changed."""
    good = vehicle.cloud_message(1, POINTS).fields
    return good[:-1] + [dataclasses.replace(good[-1], **changes)]


def bad_stamp():
    stamp = ros.message("builtin_interfaces/Time", sec=1, nanosec=10**9)
    return ros.message("std_msgs/Header", stamp=stamp, frame_id="")


WAYS = {
    "image, stamp": ("malformed:stamp", IMAGE, lambda: image(header=bad_stamp())),
    "image, encoding": ("malformed:encoding", IMAGE, lambda: image(encoding="\x1b[2Jnone")),
    "image, depth": ("malformed:depth_encoding", IMAGE, lambda: image(encoding="16UC1")),
    "image, no pixels": ("malformed:image_size", IMAGE, lambda: image(width=0)),
    "image, size overflows": ("malformed:image_size", IMAGE, lambda: image(width=2**31, height=2**31, step=2**31)),
    "image, step": ("malformed:step", IMAGE, lambda: image(step=5, data=np.zeros(20, np.uint8))),
    "image, data": ("malformed:image_data", IMAGE, lambda: image(data=np.zeros(23, np.uint8))),
    "image, step overflows": ("malformed:image_data", IMAGE, lambda: image(step=2**30, data=np.zeros(25, np.uint8))),
    "image, padding": ("malformed:step", IMAGE, lambda: image(step=9000, data=np.zeros(36_000, np.uint8))),
    "image, too much data": ("malformed:image_data", IMAGE, lambda: image(data=np.zeros(100_000, np.uint8))),
    "image, another size": ("image_size_mismatch", IMAGE, image),
    "cloud, stamp": ("malformed:stamp", CLOUD, lambda: cloud(header=bad_stamp())),
    "cloud, point step 0": ("malformed:point_step", CLOUD, lambda: cloud(point_step=0)),
    "cloud, point step": ("malformed:point_step", CLOUD, lambda: cloud(point_step=4097)),
    "cloud, points": ("malformed:cloud_size", CLOUD, lambda: cloud(width=4_000_001)),
    "cloud, points overflow": ("malformed:cloud_size", CLOUD, lambda: cloud(width=2**16, height=2**16)),
    "cloud, fields": ("malformed:fields", CLOUD, lambda: cloud(fields=fields() * 17)),
    "cloud, field type": ("malformed:field_type", CLOUD, lambda: cloud(fields=fields(datatype=9))),
    "cloud, field offset": ("malformed:field_bounds", CLOUD, lambda: cloud(fields=fields(offset=13))),
    "cloud, field offset overflows": ("malformed:field_bounds", CLOUD, lambda: cloud(fields=fields(offset=2**32 - 1))),
    "cloud, field count overflows": ("malformed:field_bounds", CLOUD, lambda: cloud(fields=fields(count=2**32 - 1))),
    "cloud, no z": ("malformed:xyz", CLOUD, lambda: cloud(fields=fields()[:2])),
    "cloud, two z": ("malformed:xyz", CLOUD, lambda: cloud(fields=fields(name="z"))),
    "cloud, row step": ("malformed:row_step", CLOUD, lambda: cloud(height=2, width=3, row_step=47, data=np.zeros(95, np.uint8))),
    "cloud, byte order": ("malformed:cloud_layout", CLOUD, lambda: cloud(is_bigendian=True)),
    "cloud, data": ("malformed:cloud_data", CLOUD, lambda: cloud(data=np.zeros(95, np.uint8))),
    "cloud, row step overflows": ("malformed:cloud_data", CLOUD, lambda: cloud(height=3, width=2, row_step=2**32 - 1,
                                                                                  data=np.zeros(97, np.uint8))),
    # More than 32 MB is refused too, but seldom survives default socket buffers: decode_test has that bound.
    "compressed, empty": ("malformed:compressed_size", COMPRESSED, lambda: compressed(b"")),
    "compressed, format": ("malformed:compressed_format", COMPRESSED, lambda: compressed(b"GIF89a" + bytes(64))),
    "compressed, depth": ("malformed:depth_encoding", COMPRESSED, lambda: compressed(png(8, 8), "16UC1; png")),
    "compressed, bomb": ("malformed:compressed_dimensions", COMPRESSED, lambda: compressed(png(60_000, 60_000))),
    "compressed, another size": ("image_size_mismatch", COMPRESSED, lambda: compressed(png(8, 8))),
    "compressed, too many bytes": ("malformed:compressed_size", COMPRESSED, lambda: compressed(
        png(scene.WIDTH, scene.HEIGHT) + bytes(4 * scene.WIDTH * scene.HEIGHT + 2**16))),
    "compressed, data": ("malformed:compressed_data", COMPRESSED, lambda: compressed(png(scene.WIDTH, scene.HEIGHT)[:-30])),
    "compressed, pixels": ("malformed:compressed_data", COMPRESSED, lambda: compressed(png(scene.WIDTH, scene.HEIGHT))),
    "compressed, scans": ("malformed:compressed_scans", COMPRESSED, lambda: compressed(
        jpeg_of_scans(scene.WIDTH, scene.HEIGHT, 33))),
    "compressed, many scans of many pixels": ("image_size_mismatch", COMPRESSED, lambda: compressed(SCANS_BOMB)),
    "compressed, many pixels": ("image_size_mismatch", COMPRESSED, lambda: compressed(PIXELS_BOMB)),
    "info, not finite": ("malformed:intrinsics", INFO, lambda: info(k=with_focal_length(float("nan")))),
    "info, focal length": ("malformed:intrinsics", INFO, lambda: info(k=with_focal_length(1e5))),
    "info, no calibration": ("malformed:uncalibrated", INFO, lambda: info(k=np.zeros(9))),
    "info, distortion": ("malformed:distortion", INFO, lambda: info(d=np.zeros(3))),
    "info, model": ("malformed:distortion", INFO, lambda: info(distortion_model="pancake")),
    "imu, stamp": ("malformed:stamp", IMU, lambda: imu(header=bad_stamp())),
    "imu, not finite": ("malformed:angular_velocity", IMU, lambda: imu(turn=float("nan"))),
    "imu, none": ("malformed:angular_velocity", IMU, lambda: imu(first_covariance=-1.0)),
    "info, size": ("malformed:image_size", INFO, lambda: info(width=2**31, height=2**31)),
}


@dataclasses.dataclass
class Bench:
    daemon: vehicle.Calibd
    writers: dict
    peer: ros.Peer
    frames: list

    def counted(self, reason):
        """As what a message was not used for, or as a remark."""
        return sum(pair["skipped"].get(reason, 0) + pair["remarks"].get(reason, {"count": 0})["count"]
                   for pair in self.daemon.pairs().values())

    def evaluates(self):
        """The next good pairs are evaluated."""
        before = self.daemon.pair()["evaluated"]
        with vehicle.Vehicle(self.peer, self.frames):
            self.daemon.wait_for(lambda: self.daemon.pair()["evaluated"] >= before + 2, 60)


@pytest.fixture(scope="module")
def bench(bin_dir, dds_domain, tmp_path_factory):
    peer = ros.Peer(dds_domain)
    writers = {kind: peer.writer(*topic) for kind, topic in TOPICS.items()}
    folder = tmp_path_factory.mktemp("calibd")
    config = vehicle.configuration(folder, dds_domain, "500ms", "500ms")
    rear = copy.deepcopy(config["pairs"][0])
    rear["name"] = "rear"
    rear["camera"]["image"], rear["depth"]["right_image"] = TOPICS[COMPRESSED][1], "/rear/right/compressed"
    rear["lidar"]["cloud"] = "/rear/points"
    rear["motion"] = {"topic": TOPICS[IMU][1], "type": "imu"}
    config["pairs"][0]["camera"]["info"] = TOPICS[INFO][1]
    config["pairs"].append(rear)
    with vehicle.Calibd(bin_dir, folder, config) as daemon:
        yield Bench(daemon, writers, peer, vehicle.render(6))


@pytest.mark.parametrize("way", WAYS)
def test_a_malformed_message_is_counted_under_its_reason(bench, way):
    reason, kind, make = WAYS[way]
    encoded, before = make(), bench.counted(reason)

    def counted():
        for _ in range(10):  # readers come and go with the sampling window
            ros.write_cdr(bench.writers[kind], encoded)
            time.sleep(0.02)
        return bench.counted(reason) > before

    bench.daemon.wait_for(counted, 60)


def test_after_all_of_them_the_next_good_pair_is_evaluated(bench):
    bench.evaluates()


@dataclasses.dataclass
class LyingImage(IdlStruct, typename=ros.dds_name("sensor_msgs", "Image")):
    """Says that it is an Image and sends a length and that many bytes, for what reads them to make of what it will."""
    anything: sequence[uint8]


@dataclasses.dataclass
class LyingCloud(IdlStruct, typename=ros.dds_name("sensor_msgs", "PointCloud2")):
    anything: sequence[uint8]


@pytest.mark.parametrize("kind,topic", [(LyingImage, vehicle.LEFT), (LyingCloud, vehicle.CLOUD)])
def test_bytes_that_are_no_such_message_are_dropped(bench, dds_domain, kind, topic):
    liar = ros.Peer(dds_domain).writer(kind, topic)
    honest = image() if kind is LyingImage else cloud()
    for lie in (b"", b"\0" * 64, b"\xff" * 64, honest[8:40], honest[8:-30], np.random.default_rng(1).bytes(5000)):
        for _ in range(40):
            liar.write(kind(anything=list(lie)))
            time.sleep(0.02)
    del liar
    bench.evaluates()


def test_a_cloud_of_thousands_of_fields_is_dropped_before_they_take_memory(bench):
    encoded, before = cloud(fields=fields() * 400), bench.counted("malformed:fields")
    for _ in range(40):
        ros.write_cdr(bench.writers[CLOUD], encoded)
        time.sleep(0.02)
    assert bench.counted("malformed:fields") == before
    bench.evaluates()


def test_thousands_of_them_cost_no_memory(bench):
    big = np.zeros((240, 640), np.uint8)
    floods = [(kind, make()) for _, kind, make in WAYS.values()]
    floods.append((IMAGE, ros.cdr(IMAGE, dataclasses.replace(vehicle.image_message(1, big), step=639))))

    def flood(rounds):
        for _ in range(rounds):
            for kind, encoded in floods:
                ros.write_cdr(bench.writers[kind], encoded)
            time.sleep(0.005)

    def total():
        return sum(count for pair in bench.daemon.pairs().values() for reason, count in pair["skipped"].items()
                   if reason.startswith("malformed:"))

    bench.evaluates()  # everything is allocated that ever will be
    flood(50)
    resident, counted = bench.daemon.resident_bytes(), total()
    flood(200)
    assert total() > counted + 200, "the flood was not seen"
    grown = bench.daemon.resident_bytes() - resident
    assert grown < 8 * 2**20, f"{grown / 2**20:.1f} MiB more after the second flood"
    bench.evaluates()


def two_pairs(folder, domain):
    """The front one reads raw images, the rear one compressed ones."""
    config = vehicle.configuration(folder, domain, "500ms", "500ms")
    rear = copy.deepcopy(config["pairs"][0])
    rear["name"], rear["camera"]["image"] = "rear", TOPICS[COMPRESSED][1]
    rear["lidar"]["cloud"], rear["depth"]["right_image"] = "/rear/points", "/rear/right/compressed"
    config["pairs"].append(rear)
    return config


def test_images_that_ask_for_minutes_and_gigabytes_cost_neither(bench, bin_dir, tmp_path, dds_domain, slowdown):
    """A flood of them at the rear camera's topic: the front pair is evaluated, questions are answered, SIGTERM is obeyed."""
    bombs = [ros.cdr(COMPRESSED, ros.message("sensor_msgs/CompressedImage", header=ros.header(1, "camera"), format="jpeg",
                                             data=np.frombuffer(data, np.uint8)))
             for data in (SCANS_BOMB, PIXELS_BOMB, jpeg_of_scans(scene.WIDTH, scene.HEIGHT, 32))]
    with vehicle.Calibd(bin_dir, tmp_path, two_pairs(tmp_path, dds_domain)) as daemon, \
            vehicle.Vehicle(bench.peer, bench.frames):
        daemon.wait_for(lambda: daemon.pair()["evaluated"] >= 2, 60)
        peak, evaluated, end = daemon.peak_bytes(), daemon.pair()["evaluated"], time.monotonic() + 4 * slowdown
        while time.monotonic() < end:
            for bomb in bombs:
                ros.write_cdr(bench.writers[COMPRESSED], bomb)
            time.sleep(0.01)
        pairs = daemon.pairs()
        assert pairs["rear"]["skipped"]["image_size_mismatch"] > 2, daemon.log()
        assert pairs["front"]["evaluated"] > evaluated, daemon.log()
        assert daemon.peak_bytes() - peak < 32 * 2**20, f"{(daemon.peak_bytes() - peak) / 2**20:.1f} MiB more"
        asked = time.monotonic()
        daemon.stop()
        assert time.monotonic() - asked < 2 * slowdown, daemon.log()


def udp_ports(pid):
    """On which a process listens."""
    sockets = set()
    for entry in pathlib.Path(f"/proc/{pid}/fd").iterdir():
        try:
            sockets.add(entry.readlink().name)
        except FileNotFoundError:
            pass  # the folder's own
    lines = pathlib.Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]
    return [int(line.split()[1].split(":")[1], 16) for line in lines if f"socket:[{line.split()[9]}]" in sockets]


def test_malformed_packets_do_not_fill_the_log(bench, bin_dir, tmp_path, dds_domain):
    """Each is a line of Cyclone's: a few come through, the others are counted."""
    config = vehicle.configuration(tmp_path, dds_domain)
    packet = b"RTPS\2\1\1\x10" + b"hostile peer" + b"\x15\5\4\0" + b"\xff" * 4  # DATA of four bytes
    with vehicle.Calibd(bin_dir, tmp_path, config) as daemon, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as out:
        daemon.wait_for(lambda: udp_ports(daemon.pid()) and daemon.pairs(), 30)
        ports = udp_ports(daemon.pid())
        sent, end = 0, time.monotonic() + 2
        while time.monotonic() < end and sent < 20_000:
            for port in ports:
                out.sendto(packet, ("127.0.0.1", port))
                sent += 1
            time.sleep(0.0005)
        assert daemon.pairs()
        daemon.stop()
        log = daemon.log()
        assert len(log) < 8000, f"{len(log)} bytes, {log[:2000]}"
        assert log.count("malformed packet") <= 11, log
        summary = re.search(r"Cyclone DDS: (\d+) more messages in the last minute, the last: malformed packet", log)
        assert summary and int(summary[1]) > 100, log
