"""calibctl doctor with the real calibd and calib-sim: it names each mistake in the configuration of a vehicle, and none if there is none.

One calibd watches one simulated street through a pair per mistake, so that the vehicle is driven once.
"""

import contextlib
import copy
import hashlib
import json
import math
import pathlib
import subprocess
import sys
import threading
import time
import types

import numpy as np
import pytest

from conftest import DONE, FAILED, NOT_FOUND

onnx = pytest.importorskip("onnx", reason="no onnx package for this machine")
yaml = pytest.importorskip("ruamel.yaml")

SIZE = [480, 160]
STREET = ["--width", SIZE[0], "--height", SIZE[1], "--lidar-step-deg", 0.5, "--lidar-fov-deg", 120, "--rate", 8]
REAR = {"image": "/rear/left/image", "right_image": "/rear/right/image", "cloud": "/rear/points"}


# ---- rotations, as somebody who configures calibd would compute them

def matrix_of(xyzw):
    x, y, z, w = xyzw
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]])


def inverse(transform):
    x, y, z, w = transform["quaternion_xyzw"]
    back = [-x, -y, -z, w]
    return {"translation_m": (-matrix_of(back) @ transform["translation_m"]).tolist(), "quaternion_xyzw": back}


def quaternion(roll, pitch, yaw):
    """Of Rz(yaw) Ry(pitch) Rx(roll), radians."""
    (a, b, c), (d, e, f) = ([g(angle / 2) for angle in (roll, pitch, yaw)] for g in (math.sin, math.cos))
    return [a * e * f - d * b * c, d * b * f + a * e * c, d * e * c - a * b * f, d * e * f + a * b * c]


def radians_taken_for_degrees(transform):
    R = matrix_of(transform["quaternion_xyzw"])
    angles = [math.atan2(R[2, 1], R[2, 2]), math.asin(-R[2, 0]), math.atan2(R[1, 0], R[0, 0])]
    return {**transform, "quaternion_xyzw": quaternion(*np.radians(angles))}


# ---- a network whose depth is known: a road between two walls, whatever the image shows

def write_network(folder, name, semantics):
    width, height = SIZE
    u, v = np.meshgrid(np.arange(width), np.arange(height))
    road, walls = np.maximum(v - 0.47 * height, 0) / 1.65, np.abs(u - width / 2) / 5.5
    street = np.maximum(road + 1e-3 * (v + 1), walls).astype(np.float32)[None, None]
    helper, numpy_helper = onnx.helper, onnx.numpy_helper
    graph = helper.make_graph(
        [helper.make_node("ReduceMean", ["image"], ["grey"], axes=[1], keepdims=1),
         helper.make_node("Mul", ["grey", "nothing"], ["zero"]), helper.make_node("Add", ["zero", "street"], ["depth"])],
        "street", [helper.make_tensor_value_info("image", onnx.TensorProto.FLOAT, [1, 3, height, width])],
        [helper.make_tensor_value_info("depth", onnx.TensorProto.FLOAT, [1, 1, height, width])],
        [numpy_helper.from_array(np.float32(0), "nothing"), numpy_helper.from_array(street, "street")])
    model = helper.make_model(graph, ir_version=8, opset_imports=[helper.make_opsetid("", 13)])
    file = folder / f"{name}.onnx"
    file.write_bytes(model.SerializeToString())
    descriptor = folder / f"{name}.yaml"
    descriptor.write_text(json.dumps({
        "file": file.name, "sha256": hashlib.sha256(file.read_bytes()).hexdigest(),
        "input": {"name": "image", "layout": "nchw", "channel_order": "rgb", "size": SIZE, "scale": 1},
        "output": {"name": "depth", "semantics": semantics}}))
    return descriptor


# ---- the mistakes: pair, the check and code that must be reported, words of the report, and how the right pair is changed

MISTAKES = []


def mistake(check, code, words):
    def keep(spoil):
        MISTAKES.append((spoil.__name__, check, code, words, spoil))
        return spoil
    return keep


@mistake("cloud", "wrong_topic", "/lidar/points")
def wrong_topic(pair, _):
    pair["lidar"]["cloud"] = "/lidar/pointz"


@mistake("cloud", "wrong_type", "sensor_msgs/msg/Image")
def wrong_type(pair, _):
    pair["lidar"]["cloud"] = "/camera/right/image"


@mistake("lens", "wrong_lens_model", "rectified")
def wrong_model(pair, _):
    camera, depth = pair["camera"], pair["depth"]
    camera["model"], camera["distortion"] = "equidistant", [0.0, 0.0, 0.0, 0.0]
    depth["right_camera"] = {key: camera[key] for key in ("model", "size", "intrinsics", "distortion")} | {
        "T_right_left": {"translation_m": [-depth.pop("baseline_m"), 0, 0], "quaternion_xyzw": [0, 0, 0, 1]}}


@mistake("depth", "stereo_swapped", "exchange")
def swapped_left_and_right(pair, _):
    pair["camera"]["image"], pair["depth"]["right_image"] = pair["depth"]["right_image"], pair["camera"]["image"]


@mistake("extrinsic", "extrinsic_inverse", "inverse")
def inverted_extrinsic(pair, _):
    pair["T_camera_lidar"] = inverse(pair["T_camera_lidar"])


@mistake("extrinsic", "extrinsic_radians_as_degrees", "radians that were taken for degrees")
def radians_for_degrees(pair, _):
    pair["T_camera_lidar"] = radians_taken_for_degrees(pair["T_camera_lidar"])


@mistake("clock", "stale_clock", "/lidar/stale is stamped 60.")
def stale_clock(pair, _):
    pair["lidar"]["cloud"] = "/lidar/stale"


@mistake("image_size", "image_size_mismatch", "scaled by 0.5")
def wrong_image_size(pair, _):
    pair["camera"]["size"] = [2 * side for side in SIZE]
    pair["camera"]["intrinsics"] = [2 * value for value in pair["camera"]["intrinsics"]]


@mistake("agreement", "depth_inverted", "semantics")
def depth_semantics_inverted(pair, folder):
    pair["depth"] = {"source": "onnx", "model": str(write_network(folder, "inverted", "depth_relative"))}


@mistake("depth", "depth_model_refused", "altered")
def model_file_altered(pair, folder):
    pair["depth"] = {"source": "onnx", "model": str(write_network(folder, "altered", "inverse_relative"))}
    with open(folder / "altered.onnx", "r+b") as file:
        file.seek(-9, 2)
        file.write(b"\x01")


@mistake("right_image", "no_publisher", "driver does not run")
def right_image_missing(pair, _):
    pair["depth"]["right_image"] = "/camera/third/image"


@mistake("cloud_range", "cloud_unit", "millimetres")
def cloud_in_another_unit(pair, _):
    pair["lidar"]["cloud"] = "/lidar/millimetres"


HEALTHY = ["healthy", "healthy_network", "best_effort"]


def configuration(folder, domain, right):
    """The pairs of all tests, from the right one."""
    pairs = [copy.deepcopy(right) | {"name": name} for name in HEALTHY]
    pairs[1]["depth"] = {"source": "onnx", "model": str(write_network(folder, "street", "inverse_relative"))}
    rear = pairs[2]
    rear["camera"]["image"], rear["depth"]["right_image"] = REAR["image"], REAR["right_image"]
    rear["lidar"]["cloud"] = REAR["cloud"]
    for name, *_, spoil in MISTAKES:
        pairs.append(copy.deepcopy(right) | {"name": name})
        spoil(pairs[-1], folder)
    return {"vehicle": "doctor-car", "state_dir": str(folder), "runtime_dir": str(folder),
            "dds": {"domain": domain, "interface": "lo"}, "signing_key": str(folder / "signing.key"),
            "sampling": {"period": "60s", "window": "300ms", "max_time_difference": "150ms"}, "pairs": pairs}


class Clouds:
    """Publishes a cloud a minute late and one in millimetres, by another DDS program."""

    def __init__(self, domain):
        pytest.importorskip("cyclonedds", reason="no cyclonedds package for this machine")
        sys.path.append(str(pathlib.Path(__file__).parents[1] / "interop"))
        import ros
        import vehicle
        self._ros, self._message = ros, vehicle.cloud_message
        peer = ros.Peer(domain)
        self._writers = {name: peer.writer(ros.PointCloud2, f"/lidar/{name}", reliable=False)
                         for name in ("stale", "millimetres")}
        angles = np.linspace(-1, 1, 4000)
        wall = np.stack([12 * np.cos(angles), 12 * np.sin(angles), np.linspace(-2, 1, 4000), np.ones(4000)], -1)
        self._wall = wall.astype(np.float32)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._publish)

    def _publish(self):
        while not self._stop.wait(0.1):
            for name, late_ns, unit in (("stale", 60 * 10**9, 1), ("millimetres", 0, 1000)):
                points = self._wall * np.array([unit, unit, unit, 1], np.float32)
                message = self._message(time.time_ns() - late_ns, points)
                self._ros.write_cdr(self._writers[name], self._ros.cdr("sensor_msgs/PointCloud2", message))

    def __enter__(self):
        self._thread.start()

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()


@contextlib.contextmanager
def running(command, log):
    with open(log, "wb") as out, open(log.with_suffix(".err"), "wb") as err:
        process = subprocess.Popen([str(word) for word in command], stdout=out, stderr=err)
    try:
        yield process
    finally:
        process.terminate()
        process.wait(30)


@pytest.fixture(scope="module")
def car(bin_dir, dds_domain, slowdown, tmp_path_factory):
    """The vehicle, calibd, and a way to ask calibctl."""
    folder = tmp_path_factory.mktemp("doctor")
    sim = [bin_dir / "calib-sim", "--domain", dds_domain, *STREET]
    front = [*sim, "--motion-topic", "/imu/data"]
    printed = subprocess.run([str(word) for word in [*front, "--print-config"]], capture_output=True, text=True, check=True)
    right, = yaml.YAML(typ="safe").load(printed.stdout)["pairs"]
    subprocess.run([bin_dir / "calibctl", "keygen", "--out", folder / "signing.key"], check=True, capture_output=True)
    config = folder / "calibd.yaml"
    config.write_text(json.dumps(configuration(folder, dds_domain, right), indent=1))
    rear = [*sim, "--best-effort", "--seed", 2, "--left-image", REAR["image"], "--right-image", REAR["right_image"], "--cloud",
            REAR["cloud"], "--left-info", "/rear/left/camera_info", "--right-info", "/rear/right/camera_info"]

    def ask(*arguments):
        ended = subprocess.run([bin_dir / "calibctl", "--socket", folder / "control.sock", *arguments], capture_output=True,
                               text=True, timeout=300 * slowdown, check=False)
        return types.SimpleNamespace(exit=ended.returncode, out=ended.stdout, err=ended.stderr)

    with running(front, folder / "sim.log"), running(rear, folder / "rear.log"), Clouds(dds_domain), \
            running([bin_dir / "calibd", "--config", config], folder / "calibd.log") as calibd:
        deadline = time.monotonic() + 60 * slowdown
        while ask("status").exit != DONE:
            log = (folder / "calibd.err").read_text()
            assert calibd.poll() is None and time.monotonic() < deadline, log
            time.sleep(0.2)
        yield types.SimpleNamespace(ask=ask, folder=folder)
        assert calibd.poll() is None, (folder / "calibd.err").read_text()


@pytest.fixture(scope="module")
def answer(car):
    """Of all pairs at once."""
    done = car.ask("doctor", "--json")
    assert done.exit == FAILED, done.err
    return json.loads(done.out)


def checks_of(answer, pair):
    return {check["check"]: check for check in answer["checks"] if check["pair"] == pair}


def problems(answer, pair):
    return {name: check["code"] for name, check in checks_of(answer, pair).items() if check["result"] == "problem"}


@pytest.mark.parametrize("pair, check, code, words", [entry[:4] for entry in MISTAKES], ids=[entry[0] for entry in MISTAKES])
def test_a_mistake_is_named_with_its_cause(answer, pair, check, code, words):
    found = checks_of(answer, pair)
    assert found[check].get("code") == code, found
    assert found[check]["result"] == "problem"
    assert words in found[check]["seen"] + found[check]["cause"] + found[check]["remedy"]
    assert problems(answer, pair) == {check: code}


def test_all_twelve_mistakes_are_named(answer):
    assert sum(problems(answer, pair) == {check: code} for pair, check, code, *_ in MISTAKES) == 12


@pytest.mark.parametrize("pair", HEALTHY)
def test_a_healthy_pair_has_no_problem(answer, pair):
    found = checks_of(answer, pair)
    assert {name: check for name, check in found.items() if check["result"] != "ok"} == {}
    expected = {"image", "cloud", "motion_topic", "camera_info", "clock", "pairing", "image_size", "lens", "cloud_range", "scene", "depth",
                "extrinsic", "agreement"}
    assert expected <= set(found)


def test_the_answer_matches_its_schema(answer, schema):
    schema("doctor", answer)


def test_one_pair_can_be_diagnosed_and_exits_with_zero_if_healthy(car, tmp_path):
    done = car.ask("doctor", "healthy", "--overlay", tmp_path / "pictures")
    assert done.exit == DONE, done.out + done.err
    lines = done.out.splitlines()
    assert lines[0] == "Pair            : healthy" and lines[1] == "Found           : 0 problems, 0 warnings"
    assert all(line[16:18] == ": " for line in lines) and "\x1b" not in done.out
    picture = tmp_path / "pictures" / "healthy.png"
    assert lines[-1] == f"Picture         : {picture}"
    # A heading, the image with its points, and depth below it.
    header = picture.read_bytes()[:24]
    assert header[:8] == b"\x89PNG\r\n\x1a\n"
    width, height = int.from_bytes(header[16:20], "big"), int.from_bytes(header[20:24], "big")
    assert width == SIZE[0] and 2 * SIZE[1] + 60 < height < 3 * SIZE[1]


def test_problems_come_first_with_cause_and_remedy(car):
    done = car.ask("doctor", "wrong_topic")
    assert done.exit == FAILED
    lines = done.out.splitlines()
    assert lines[1].startswith("Found           : 1 problem, ")
    assert lines[2].startswith("Cloud           : PROBLEM: nobody publishes /lidar/pointz")
    assert lines[3].startswith("  likely cause  : ") and lines[4].startswith("  remedy        : ")
    assert lines[5] == "  code          : wrong_topic"


def test_there_is_one_picture_per_pair_in_the_state_folder(car, answer):
    files = {overlay["pair"]: pathlib.Path(overlay["file"]) for overlay in answer["overlays"]}
    assert files["healthy"] == car.folder / "doctor" / "healthy.png" and files["healthy"].stat().st_size > 1000
    assert "wrong_topic" not in files
    assert {path.name for path in (car.folder / "doctor").iterdir()} == {f"{pair}.png" for pair in files}


def test_a_diagnosis_changes_and_counts_nothing(car):
    before = {pair["name"]: pair for pair in json.loads(car.ask("status", "--json").out)["pairs"]}
    assert car.ask("doctor", "healthy").exit == DONE
    after = {pair["name"]: pair for pair in json.loads(car.ask("status", "--json").out)["pairs"]}
    for key in ("verdict", "evaluated", "skipped", "record", "since", "last_evaluated"):
        assert before["healthy"][key] == after["healthy"][key]


def test_status_is_answered_during_a_diagnosis(car):
    thread = threading.Thread(target=car.ask, args=("doctor", "healthy", "--json"))
    thread.start()
    assert car.ask("status").exit == DONE and thread.is_alive()
    thread.join()


def test_a_pair_that_does_not_exist_is_refused(car):
    refused = car.ask("doctor", "front-left")
    assert refused.exit == NOT_FOUND and refused.out == "" and "front-left" in refused.err


def test_without_a_daemon_the_remedy_is_printed(bare):
    alone = bare("doctor")
    assert alone.exit == NOT_FOUND and alone.out == ""
    for remedy in ("calibctl check-config", "systemctl status calibd", "journalctl -u calibd"):
        assert remedy in alone.err
