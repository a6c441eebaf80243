"""calib-uplink with the real calibd and a real broker: whatever is cut or killed, every alert arrives, in order."""

import contextlib
import datetime
import json
import os
import pathlib
import random
import signal
import subprocess
import tempfile
import threading
import time

import pytest

pytest.importorskip("paho.mqtt.client")
from support.feed import (Authority, Broker, Consumer, OldBroker, ask, authority, check_feed,  # noqa: E402,F401
                          is_signed, schema_validator, wait_for)

# So often each is killed. 100 by hand, see README.md.
KILLS = int(os.environ.get("CALIBD_FEED_KILLS", "4"))
# So many are timed, online and after a cut. 1000 by hand.
EVENTS = int(os.environ.get("CALIBD_FEED_EVENTS", "60"))

CALIBD = """
vehicle: demo-car
state_dir: {folder}/state
runtime_dir: {folder}
signing_key: {folder}/signing.key
dds: {{domain: {domain}, interface: lo}}
sampling: {{period: 200ms, window: 50ms}}
pairs:
  - name: front
    camera: {{image: /left, model: rectified, size: [640, 192], intrinsics: [400, 400, 320, 96]}}
    lidar: {{cloud: /points}}
    T_camera_lidar: {{translation_m: [0, 0, 0], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}}
    depth: {{source: stereo, right_image: /right, baseline_m: 0.5}}
"""


class Program:
    """A program that is started, killed and started again."""

    def __init__(self, log, *command):
        self.command, self.log, self.running = command, log, None

    def start(self):
        with open(self.log, "ab") as log:
            self.running = subprocess.Popen(self.command, stdout=log, stderr=log)

    def stop(self, how=signal.SIGTERM):
        if self.running:
            self.running.send_signal(how)
            code = self.running.wait(timeout=30)
            self.running = None
            return code
        return None

    def said(self):
        return pathlib.Path(self.log).read_text()


class Vehicle:
    """calibd, which no sensor feeds, and calib-uplink."""

    def __init__(self, bin_dir, folder, domain):
        self.folder = pathlib.Path(folder)
        self.socket = self.folder / "control.sock"
        self.public_key = self.folder / "signing.pub"
        subprocess.run([bin_dir / "calibctl", "keygen", "--out", self.folder / "signing.key"], check=True,
                       capture_output=True)
        (self.folder / "calibd.yaml").write_text(CALIBD.format(folder=folder, domain=domain))
        self.calibd = Program(self.folder / "calibd.log", bin_dir / "calibd", "--config", self.folder / "calibd.yaml")
        self.uplink = Program(self.folder / "uplink.log", bin_dir / "calib-uplink", "--config",
                              self.folder / "uplink.yaml")

    def configure(self, text):
        (self.folder / "uplink.yaml").write_text(f"socket: {self.socket}\n{text}")

    def connect(self, broker, authority, client, settle="0ms"):
        self.configure(f"mqtt: {{host: localhost, port: {broker.port}, first_delay: 50ms, longest_delay: 500ms, "
                       f"settle: {settle}, "
                       f"tls: {{ca: {authority.certificate}, certificate: {client[0]}, key: {client[1]}}}}}\n")

    def start_calibd(self):
        self.calibd.start()
        wait_for(self.answers, "calibd answers")

    def answers(self):
        with contextlib.suppress(OSError, ValueError):
            return ask(self.socket, "status")["ok"]
        return False

    def waiting(self):
        return ask(self.socket, "feed")["waiting"]

    def decide(self, times=1):
        """Each makes a record and an event."""
        for _ in range(times):
            answer = ask(self.socket, "rollback", pair="front", to=1)
            assert answer["ok"], answer


@pytest.fixture
def vehicle(bin_dir, dds_domain):
    with tempfile.TemporaryDirectory() as folder:  # a short name, which a socket needs
        made = Vehicle(bin_dir, folder, dds_domain)
        yield made
        made.uplink.stop(signal.SIGKILL)
        made.calibd.stop(signal.SIGKILL)


@pytest.fixture(scope="module")
def client(authority):  # noqa: F811
    return authority.sign("demo-car")


@pytest.fixture
def broker(authority, tmp_path):  # noqa: F811
    made = Broker(tmp_path, authority)
    yield made
    made.stop(signal.SIGKILL)


@pytest.fixture
def consumer(broker, authority):  # noqa: F811
    """Of the running broker, subscribed for as long as the broker remembers."""
    broker.start()
    made = Consumer(broker, authority)
    time.sleep(1.2)  # until the broker has saved that
    yield made
    made.close()


@pytest.fixture
def validate(source_dir):
    return schema_validator(source_dir)


def all_arrived(vehicle, consumer, validate):
    """Waits until nothing waits any more, and checks what came. Returns the number of duplicates."""
    wait_for(lambda: vehicle.waiting() == 0, "the outbox is empty", 60)
    last = ask(vehicle.socket, "records", **{"from": 1})["stored"]

    def reported():
        return {json.loads(text)["data"]["record"]["sequence"] for _, text, *_ in consumer.of("alert")}

    wait_for(lambda: reported() == set(range(1, last + 1)), "each record's event has arrived")
    return check_feed([text for _, text, *_ in consumer.of("alert")], vehicle.public_key, validate)


def test_an_event_arrives_at_once_signed_and_on_its_topic(
        vehicle, broker, consumer, client, authority, validate, slowdown):  # noqa: F811
    vehicle.start_calibd()
    vehicle.connect(broker, authority, client)
    vehicle.uplink.start()
    wait_for(lambda: consumer.of("online"), "the vehicle is online")
    assert consumer.of("online")[-1][1] == "online"
    wait_for(lambda: vehicle.waiting() == 0, "the outbox is empty")
    delays = []
    for _ in range(20):
        known = len(consumer.of("alert"))
        vehicle.decide()
        decided = time.time()
        wait_for(lambda: len(consumer.of("alert")) > known, "the event arrives")  # noqa: B023
        delays.append(consumer.of("alert")[-1][3] - decided)
    assert max(delays) < 2
    assert all_arrived(vehicle, consumer, validate) == 0
    (state,) = consumer.of("state")
    event = json.loads(state[1])
    validate(event)
    assert is_signed(event, vehicle.public_key) and event["type"] == "calibd.feed.state.v1"
    assert state[0] == "fleet/v1/demo-car/calib/state"
    pid = vehicle.uplink.running.pid
    peak = int(pathlib.Path(f"/proc/{pid}/status").read_text().split("VmHWM:")[1].split()[0]) * 1024
    print(f"calib-uplink: {peak / 1e6:.1f} MB")
    assert slowdown > 1 or peak < 15e6

    vehicle.calibd.stop()
    wait_for(lambda: consumer.of("online")[-1][1] == "calibd_silent", "that calibd is silent")
    vehicle.start_calibd()
    wait_for(lambda: consumer.of("online")[-1][1] == "online", "that calibd is back")
    assert vehicle.uplink.stop() == 0
    wait_for(lambda: consumer.of("online")[-1][1] == "offline", "that the vehicle left")
    vehicle.uplink.start()
    wait_for(lambda: consumer.of("online")[-1][1] == "online", "the vehicle is online again")
    vehicle.uplink.stop(signal.SIGKILL)
    wait_for(lambda: consumer.of("online")[-1][1] == "offline", "the last will")
    assert all_arrived(vehicle, consumer, validate) == 0


def test_what_was_decided_before_there_was_a_link_arrives(vehicle, broker, consumer, client, authority, validate):  # noqa: F811
    broker.stop()  # it knows its consumer
    vehicle.connect(broker, authority, client)
    vehicle.uplink.start()  # before everything else
    time.sleep(0.3)
    vehicle.start_calibd()
    vehicle.decide(50)
    assert vehicle.waiting() >= 51
    wait_for(lambda: "no connection to the broker at localhost: Connection refused" in vehicle.uplink.said(), "a failure")
    broker.start()
    vehicle.decide(5)
    assert all_arrived(vehicle, consumer, validate) == 0


def test_no_event_is_lost_when_calib_uplink_is_killed(vehicle, broker, consumer, client, authority, validate):  # noqa: F811
    vehicle.start_calibd()
    vehicle.connect(broker, authority, client)
    vehicle.decide(30)
    for _ in range(KILLS):
        vehicle.uplink.start()
        vehicle.decide(2)
        time.sleep(random.uniform(0, 0.2))
        vehicle.uplink.stop(signal.SIGKILL)
    vehicle.uplink.start()
    print("duplicates:", all_arrived(vehicle, consumer, validate))


def test_no_event_is_lost_when_the_broker_is_killed(vehicle, broker, consumer, client, authority, validate):  # noqa: F811
    vehicle.start_calibd()
    vehicle.connect(broker, authority, client, settle="1500ms")  # it writes once a second
    vehicle.uplink.start()
    for _ in range(KILLS):
        vehicle.decide(3)
        time.sleep(random.uniform(0, 0.2))
        broker.stop(signal.SIGKILL)
        vehicle.decide(2)
        broker.start()
        time.sleep(random.uniform(0, 1))
    print("duplicates:", all_arrived(vehicle, consumer, validate))


def test_no_event_is_lost_when_calibd_is_killed(vehicle, broker, consumer, client, authority, validate):  # noqa: F811
    vehicle.start_calibd()
    vehicle.connect(broker, authority, client)
    vehicle.uplink.start()
    for _ in range(KILLS):
        killer = threading.Timer(random.uniform(0, 0.3), vehicle.calibd.stop, [signal.SIGKILL])
        killer.start()
        with contextlib.suppress(OSError, ValueError):
            vehicle.decide(100)
        killer.join()
        vehicle.start_calibd()
    print("duplicates:", all_arrived(vehicle, consumer, validate))


def test_events_arrive_within_two_seconds_and_drain_at_fifty_a_second(vehicle, broker, consumer, client, authority, validate):  # noqa: F811
    vehicle.start_calibd()
    vehicle.connect(broker, authority, client)
    vehicle.uplink.start()
    wait_for(lambda: vehicle.waiting() == 0, "the outbox is empty")
    known = len(consumer.of("alert"))
    for _ in range(EVENTS):
        vehicle.decide()
        time.sleep(random.uniform(0, 0.1))
    assert all_arrived(vehicle, consumer, validate) == 0
    delays = sorted(arrived - datetime.datetime.fromisoformat(json.loads(text)["time"]).timestamp()
                    for _, text, _, arrived in consumer.of("alert")[known:])
    p99 = delays[int(len(delays) * 0.99)]

    broker.stop()
    vehicle.decide(EVENTS)
    known = len(consumer.of("alert"))
    broker.start()
    assert all_arrived(vehicle, consumer, validate) == 0
    arrivals = [arrived for *_, arrived in consumer.of("alert")[known:]]
    rate = len(arrivals) / max(arrivals[-1] - arrivals[0], 1e-3)
    print(f"{len(delays)} events online: median {delays[len(delays) // 2] * 1e3:.0f} ms, p99 {p99 * 1e3:.0f} ms, most "
          f"{delays[-1] * 1e3:.0f} ms; {len(arrivals)} events after a cut: {rate:.0f} a second")
    assert p99 < 2 and rate > 50


@pytest.mark.parametrize("wrong", ["of another authority", "expired", "missing", "the broker's"])
def test_nothing_leaves_with_a_wrong_certificate_and_all_of_it_with_the_right_one(
        vehicle, broker, consumer, client, authority, validate, tmp_path, wrong):  # noqa: F811
    stranger = Authority(tmp_path, "stranger")
    certificate = {"of another authority": stranger.sign("demo-car"), "expired": authority.sign("old", expired=True),
                   "missing": (tmp_path / "none.pem", tmp_path / "none.key"), "the broker's": client}[wrong]
    vehicle.start_calibd()
    vehicle.connect(broker, stranger if wrong == "the broker's" else authority, certificate)
    vehicle.uplink.start()
    wait_for(lambda: "no connection to the broker at localhost: " in vehicle.uplink.said(), "a failure is logged")
    time.sleep(0.5)
    assert not consumer.messages and vehicle.waiting() > 0
    vehicle.uplink.stop()
    vehicle.connect(broker, authority, client)
    vehicle.uplink.start()
    assert all_arrived(vehicle, consumer, validate) == 0


def test_what_the_broker_refuses_stays_until_it_takes_it(vehicle, broker, consumer, client, authority, validate):  # noqa: F811
    broker.stop()
    broker.allow("online")
    broker.start()
    vehicle.start_calibd()
    vehicle.connect(broker, authority, client)
    vehicle.uplink.start()
    wait_for(lambda: "refuses an event: Not authorized" in vehicle.uplink.said(), "a refusal")
    assert vehicle.waiting() > 0 and not consumer.of("alert")
    broker.stop()
    broker.allow("#")
    broker.start()
    assert all_arrived(vehicle, consumer, validate) == 0


@pytest.mark.parametrize("refuses_with_a_word", [True, False])
def test_a_broker_of_mqtt_3_1_1_is_spoken_to_as_it_is(vehicle, refuses_with_a_word):
    broker = OldBroker(refuses_with_a_word)
    vehicle.start_calibd()
    vehicle.configure(f"mqtt: {{host: 127.0.0.1, port: {broker.port}, first_delay: 20ms, settle: 0ms}}")
    vehicle.uplink.start()
    wait_for(lambda: vehicle.waiting() == 0, "the outbox is empty")
    assert broker.levels == [5, 4]
    assert broker.published[0] == ("fleet/v1/demo-car/calib/online", "online")
    assert broker.published[1][0] == "fleet/v1/demo-car/calib/alert"
    assert json.loads(broker.published[1][1])["id"] == "demo-car-1"


def test_events_go_into_a_file_that_is_rotated_and_figures_into_another(vehicle, validate):
    vehicle.start_calibd()
    path, metrics = vehicle.folder / "events.jsonl", vehicle.folder / "uplink.prom"
    path.write_text('{"a line of before": 1}\n{"what a crash has le')
    vehicle.configure(f"file: {{path: {path}, max_size_mb: 0.01, keep: 9}}\nmetrics: {{path: {metrics}, period: 1s}}\n")
    vehicle.uplink.start()
    for _ in range(4):
        vehicle.decide(6)
        vehicle.uplink.stop(signal.SIGKILL)
        vehicle.uplink.start()
    wait_for(lambda: vehicle.waiting() == 0, "the outbox is empty")
    wait_for(lambda: metrics.exists() and "calib_uplink_calibd_answers 1\n" in metrics.read_text(), "figures")
    wait_for(lambda: "calib_uplink_events_waiting 0\n" in metrics.read_text(), "that nothing waits")
    files = [path.with_name(f"{path.name}.{number}") for number in range(9, 0, -1)] + [path]
    files = [file for file in files if file.exists()]
    assert len(files) > 2 and all(file.stat().st_size <= 10_000 for file in files)
    lines = [line for file in files for line in file.read_text().splitlines()]
    assert lines[0] == '{"a line of before": 1}'
    alerts = [line for line in lines[1:] if json.loads(line)["type"] != "calibd.feed.state.v1"]
    check_feed(alerts, vehicle.public_key, validate)
    assert json.loads(alerts[-1])["data"]["record"]["sequence"] == 25


def test_what_is_no_file_is_refused(vehicle):
    vehicle.start_calibd()
    vehicle.configure("file: {path: /dev/full}")
    vehicle.uplink.start()
    wait_for(lambda: vehicle.uplink.running.poll() is not None, "it ends")
    assert "is no regular file" in vehicle.uplink.said()
    assert vehicle.waiting() > 0


@pytest.mark.parametrize("text, error", [
    ("mqtt: {host: broker.example.com}\n", "1: mqtt.tls: missing"),
    ("mqtt: {host: localhost, tls: none}\n", "1: mqtt.tls: "),
    ("mqtt: {host: localhost, qos: 2}\n", "1: mqtt.qos: "),
    ("mqtt: {host: localhost,\n  port: 0}\n", "2: mqtt.port: "),
    ("file: {path: events}\n", "1: file.path: needs the absolute path"),
    ("metrics: {path: /tmp/x.prom}\n", "1: needs mqtt or file"),
    ("file: {path: /tmp/x}\nmetrics: {path: /tmp/x}\n", "2: metrics.path: must end in .prom"),
    ("mqtt: {host: localhost, tls: {ca: /a, certificate: /b}}\n", "1: mqtt.tls.key: missing"),
    ("mqtt: {host: localhost, version: 4}\n", "1: mqtt.version: is none of"),
    ("mqtt: {host: 'a/b'}\n", "1: mqtt.host: ")])
def test_a_wrong_configuration_ends_it_with_the_place_and_the_remedy(bin_dir, tmp_path, text, error):
    file = tmp_path / "uplink.yaml"
    file.write_text(text)
    ended = subprocess.run([bin_dir / "calib-uplink", "--config", file], capture_output=True, text=True, timeout=20,
                           check=False)
    assert ended.returncode == 78
    assert ended.stderr.startswith(f"{file}:{error}"), ended.stderr
    assert ended.stderr.count("\n") == 1


def test_the_configuration_that_is_installed_is_right(bin_dir, source_dir):
    ended = subprocess.run([bin_dir / "calib-uplink", "--config", source_dir / "systemd/uplink.yaml", "--check-config"],
                           capture_output=True, text=True, check=False)
    assert ended.returncode == 0, ended.stderr
