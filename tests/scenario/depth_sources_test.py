"""Each source of depth, from the wire to a verdict; and what an estimate that fails, or takes too long, does to the rest."""

import hashlib
import shutil
import signal
import time

import numpy as np
import onnx
import onnx.helper
import onnx.numpy_helper
import pytest
from drive import Drive

SMALL = ["--width", "480", "--height", "144", "--lidar-step-deg", "0.3", "--lidar-fov-deg", "110"]


def quick(text):
    return text.replace("500ms", "250ms") + "    drift: {baseline_pairs: 5}\n"


def depth(mapping):
    """A configuration with another source of depth."""

    def configure(text):
        lines = [f"    depth: {mapping}" if line.startswith("    depth:") else line for line in text.splitlines()]
        return quick("\n".join(lines) + "\n")

    return configure


@pytest.mark.parametrize("options, words", [
    (["--depth-topic", "/depth", "--depth-as", "16UC1"], "image: /depth"),
    (["--depth-topic", "/depth", "--depth-as", "32FC1"], "image: /depth"),
    (["--depth-topic", "/disparity", "--depth-as", "disparity"], "disparity: /disparity"),
    (["--unrectified"], "right_info: /camera/right/camera_info"),
], ids=["millimetres", "metres", "disparity", "unrectified stereo"])
def test_a_source_of_depth_leads_to_a_verdict(bin_dir, tmp_path, dds_domain, slowdown, options, words):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *SMALL, *options, rate_hz=5, configure=quick) as drive:
        assert words in drive.config.read_text()
        pair = drive.wait_for(lambda pair: pair["verdict"] != "not_evaluated", 60 * slowdown)
        assert pair["verdict"] == "calibrated", drive.log()
        if "--depth-topic" in options:
            assert pair["inputs"]["depth"]["topic"] == options[options.index("--depth-topic") + 1]
            assert pair["inputs"]["depth"]["age_s"] is not None


def test_depth_that_does_not_come_is_told(bin_dir, tmp_path, dds_domain, slowdown):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *SMALL, rate_hz=5,
               configure=depth("{source: topic, image: /nobody}")) as drive:
        pair = drive.wait_for(lambda pair: pair["reason"].startswith("depth_missing"), 30 * slowdown)
        assert pair["verdict"] == "not_evaluated" and pair["evaluated"] == 0
        assert pair["inputs"]["depth"] == {"topic": "/nobody", "age_s": None}


@pytest.fixture
def network(bin_dir, tmp_path):
    """A network with its golden pair, to spoil; a part of the build."""
    for file in (bin_dir.parent / "tests/depth_models").glob("grey.*"):
        shutil.copy(file, tmp_path)
    return tmp_path / "grey.yaml"


def spoil(file):
    file.write_bytes(file.read_bytes()[::-1])


@pytest.mark.parametrize("spoilt, words", [("grey.onnx", "grey.onnx"), ("grey.f32", "depth model self-test failed")],
                         ids=["altered", "of another mind"])
def test_a_network_that_is_not_as_described_stops_its_pair_and_nothing_else(bin_dir, tmp_path, dds_domain, slowdown, network,
                                                                            spoilt, words):
    spoil(tmp_path / spoilt)

    def two_pairs(text):
        head, pair = text.split("  - name: front\n")
        return head + depth(f"{{source: onnx, model: {network}}}")("  - name: spoilt\n" + pair) + quick(
            "  - name: front\n" + pair)

    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *SMALL, rate_hz=5, configure=two_pairs) as drive:
        pair = drive.wait_for(lambda pair: pair["skipped"].get("depth_failed", 0) > 1, 30 * slowdown)
        assert (pair["name"], pair["verdict"], pair["evaluated"]) == ("spoilt", "not_evaluated", 0)
        assert pair["reason"].startswith("depth_failed: ") and words in pair["reason"], pair["reason"]
        drive.wait_for(lambda _: drive.pairs()[1]["evaluated"] >= 2, 60 * slowdown)
        assert words in drive.ctl("status", "spoilt").stdout
        assert sum("this pair is not evaluated" in line for line in drive.log().splitlines()) == 1, drive.log()


def slow_network(folder, convolutions=200):
    """Half a minute of work and more, in steps of a part of a second."""
    weights = [onnx.numpy_helper.from_array(np.full((32, channels, 3, 3), 0.01, np.float32), f"w{channels}")
               for channels in (1, 32)]
    nodes, last = [], "image"
    for i in range(convolutions):
        nodes.append(onnx.helper.make_node("Conv", [last, f"w{1 if i == 0 else 32}"], [f"x{i}"], pads=[1, 1, 1, 1]))
        last = f"x{i}"
    nodes.append(onnx.helper.make_node("ReduceMean", [last], ["depth"], axes=[1], keepdims=1))
    shape = [1, 1, 320, 640]
    graph = onnx.helper.make_graph(
        nodes, "slow", [onnx.helper.make_tensor_value_info("image", onnx.TensorProto.FLOAT, shape)],
        [onnx.helper.make_tensor_value_info("depth", onnx.TensorProto.FLOAT, shape)], weights)
    model = onnx.helper.make_model(graph, ir_version=8, opset_imports=[onnx.helper.make_opsetid("", 17)])
    content = model.SerializeToString()
    (folder / "slow.onnx").write_bytes(content)
    (folder / "slow.yaml").write_text(
        f"file: slow.onnx\nsha256: {hashlib.sha256(content).hexdigest()}\n"
        "input: {name: image, layout: nchw, channel_order: grey, size: [640, 320], scale: 1}\n"
        "output: {name: depth, semantics: inverse_relative}\n")
    return folder / "slow.yaml"


def test_a_long_estimate_delays_no_status_and_no_end(bin_dir, tmp_path, dds_domain, slowdown):
    network = slow_network(tmp_path)
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *SMALL, rate_hz=5,
               configure=depth(f"{{source: onnx, model: {network}, timeout: 3s}}")) as drive:
        slowest_status, slowest_change, given_up = 0, 0, False
        while not given_up:
            assert drive.calibd.poll() is None, drive.log()
            asked = time.monotonic()
            given_up = drive.status()["skipped"].get("depth_failed", 0) > 0
            slowest_status = max(slowest_status, time.monotonic() - asked)
            asked = time.monotonic()
            # Nothing is changed under a pair that is measured: the answer comes when its estimate has been given up.
            assert "good pairs" in drive.ctl("recalibrate", "front").stderr
            slowest_change = max(slowest_change, time.monotonic() - asked)
        assert slowest_status < 1 * slowdown, f"{slowest_status} s for a status"
        assert slowest_change < 4 * slowdown, f"{slowest_change} s for a refusal"
        pair = drive.wait_for(lambda pair: pair["reason"].startswith("depth_failed"), 30 * slowdown)
        assert "took longer than 3 s" in pair["reason"] and pair["evaluated"] == 0
        before = drive.status()["skipped"]["depth_failed"]
        drive.wait_for(lambda pair: pair["skipped"]["depth_failed"] > before, 30 * slowdown)
        time.sleep(1)  # into the next estimate
        asked = time.monotonic()
        drive.calibd.send_signal(signal.SIGTERM)
        assert drive.calibd.wait(30) == 0
        assert time.monotonic() - asked < 1.5 * slowdown
