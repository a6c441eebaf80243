"""What reaches calibd of a vehicle that has other listeners, and of one whose samples arrive in part only."""

import contextlib
import os
import re
import socket
import struct
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="no cyclonedds package for this machine")
import ros  # noqa: E402
import vehicle  # noqa: E402
from cyclonedds.core import Policy  # noqa: E402

OTHER = """
import sys, time
sys.path.insert(0, sys.argv[1])
import ros, vehicle
peer = ros.Peer(int(sys.argv[2]))
readers = [peer.reader(kind, topic, reliable=False) for kind, topic in
           ((ros.Image, vehicle.LEFT), (ros.Image, vehicle.RIGHT), (ros.PointCloud2, vehicle.CLOUD))]
print("reads", flush=True)
time.sleep(3600)
"""


def udp_ports(pid):
    """Local ports of the UDP sockets of a process."""
    inodes = set()
    for fd in Path(f"/proc/{pid}/fd").iterdir():
        with contextlib.suppress(FileNotFoundError):
            if found := re.match(r"socket:\[(\d+)\]", os.readlink(fd)):
                inodes.add(found[1])
    table = [line.split() for line in Path(f"/proc/{pid}/net/udp").read_text().splitlines()[1:]]
    return {int(fields[1].split(":")[1], 16) for fields in table if fields[9] in inodes}


@contextlib.contextmanager
def others(count, domain):
    """Programs that read the same sensors."""
    words = [sys.executable, "-c", OTHER, str(Path(__file__).parent), str(domain)]
    running = [subprocess.Popen(words, stdout=subprocess.PIPE, text=True) for _ in range(count)]
    try:
        assert all(process.stdout.readline() == "reads\n" for process in running)
        yield
    finally:
        for process in running:
            process.kill()
            process.communicate()


def test_calibd_receives_samples_in_its_windows_and_hears_nothing_of_those_for_others(bin_dir, dds_domain, tmp_path, slowdown):
    """To several readers a writer sends by multicast, which every participant would have to receive and to drop."""
    peer, multicast_data = ros.Peer(dds_domain), 7400 + 250 * dds_domain + 1
    with (others(2, dds_domain), vehicle.Vehicle(peer, vehicle.render(4)),
          vehicle.Calibd(bin_dir, tmp_path, vehicle.configuration(tmp_path, dds_domain)) as daemon):
        daemon.wait_for(lambda: daemon.pair()["evaluated"] >= 5, 30 * slowdown)
        assert udp_ports(os.getpid()) & {multicast_data}
        assert udp_ports(daemon.pid()) and not udp_ports(daemon.pid()) & {multicast_data}


def reliability_of_readers(writer, seconds):
    """Of the readers that match, in the order of their appearance: whether each is reliable."""
    readers, end = {}, time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(Exception):  # one has come or gone meanwhile
            for handle in writer.get_matched_subscriptions():
                found = writer.get_matched_subscription_data(handle)
                readers.setdefault(str(found.key), isinstance(found.qos[Policy.Reliability], Policy.Reliability.Reliable))
        time.sleep(0.005)
    return list(readers.values())


def test_a_topic_is_read_reliably_after_three_silent_windows_and_until_it_is_heard(bin_dir, dds_domain, tmp_path, slowdown):
    """A reliable reader can hold up the writer of a topic that is only slow."""
    car = vehicle.Vehicle(ros.Peer(dds_domain), vehicle.render(1))
    with vehicle.Calibd(bin_dir, tmp_path, vehicle.configuration(tmp_path, dds_domain)) as daemon:
        reliable = reliability_of_readers(car.left, 6 * slowdown)
        assert not any(reliable[:3]) and reliable[-1], reliable
        first = reliable.index(True)
        assert all(reliable[first:]), reliable
        with car:
            daemon.wait_for(lambda: daemon.pair()["evaluated"] >= 1, 30 * slowdown)
            assert not all(reliability_of_readers(car.left, 3 * slowdown))


def first_of_two_fragments(guid, sequence):
    """RTPS 2.1, 9.4.5.4: a DataFrag submessage of a writer."""
    body = struct.pack("<HH4s4siIIHHI", 0, 28, b"\0" * 4, guid[12:], 0, sequence, 1, 1, 1024, 2048) + b"\0\1\0\0" + b"\0" * 1020
    return b"RTPS\2\1\1\x10" + guid[:12] + struct.pack("<BBH", 0x16, 1, len(body)) + body


def test_a_topic_is_heard_again_after_samples_that_arrived_in_part_only(bin_dir, dds_domain, tmp_path, slowdown):
    """Cyclone keeps a few incomplete samples of a reliable writer, and drops what comes after them."""
    frames = vehicle.render(4)
    car = vehicle.Vehicle(ros.Peer(dds_domain), frames)
    image = ros.cdr("sensor_msgs/Image", vehicle.image_message(1, frames[0][0]))
    for _ in range(20):  # before calibd is there
        ros.write_cdr(car.left, image)
    with vehicle.Calibd(bin_dir, tmp_path, vehicle.configuration(tmp_path, dds_domain)) as daemon:
        daemon.wait_for(lambda: daemon.pair()["skipped"], 20 * slowdown)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as wire:
            for turn in range(100):
                packet = first_of_two_fragments(car.left.guid.bytes, 1 + turn % 16)
                for port in udp_ports(daemon.pid()):
                    wire.sendto(packet, ("127.0.0.1", port))
                time.sleep(0.02)
        with car:
            daemon.wait_for(lambda: daemon.pair()["evaluated"] >= 3, 30 * slowdown)
