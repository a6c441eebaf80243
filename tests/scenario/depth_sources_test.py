"""Each source of depth, from the wire to a verdict; and what an estimate that fails, or takes too long, does to the rest."""

import json
import signal
import subprocess
import time

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
    (["--unrectified", "--depth-topic", "/depth"], "model: plumb_bob"),
], ids=["millimetres", "metres", "disparity", "unrectified stereo", "metres through a lens"])
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


def test_a_network_that_was_altered_stops_its_pair_and_nothing_else(bin_dir, tmp_path, dds_domain, slowdown):
    network = tmp_path / "network.onnx"
    network.write_bytes(b"not what was described")
    (tmp_path / "network.yaml").write_text(
        f"file: {network.name}\nsha256: {'0' * 64}\n"
        "input: {name: image, layout: nchw, size: [64, 32], fit: stretch, channel_order: rgb, scale: 1, mean: [0, 0, 0],\n"
        "        std: [1, 1, 1]}\noutput: {name: depth, semantics: inverse_relative}\n")

    def two_pairs(text):
        head, pair = text.split("  - name: front\n")
        onnx = depth(f"{{source: onnx, model: {tmp_path}/network.yaml}}")("  - name: altered\n" + pair)
        return head + onnx + quick("  - name: front\n" + pair)

    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *SMALL, rate_hz=5, configure=two_pairs) as drive:
        pair = drive.wait_for(lambda pair: pair["skipped"].get("depth_failed", 0) > 1, 30 * slowdown)
        assert (pair["name"], pair["verdict"], pair["evaluated"]) == ("altered", "not_evaluated", 0)
        assert pair["reason"].startswith("depth_failed: ") and "network.onnx" in pair["reason"], pair["reason"]
        other = drive.wait_for(lambda _: drive.pairs()[1]["evaluated"] >= 2, 60 * slowdown)
        assert other["verdict"] == "not_evaluated"
        shown = drive.ctl("status")
        assert "depth_failed" in shown.stdout
        assert sum("this pair is not evaluated" in line for line in drive.log().splitlines()) == 1, drive.log()


def test_a_long_estimate_delays_no_question_is_given_up_and_does_not_hold_up_the_end(bin_dir, tmp_path, dds_domain,
                                                                                     slowdown):
    """Stereo matching of 6 megapixels takes seconds, and OpenCV cannot be interrupted in it."""
    large = ["--width", "3072", "--height", "1920", "--lidar-step-deg", "1", "--lidar-fov-deg", "90"]
    configure = lambda text: text.replace("window: 500ms", "window: 20s").replace("period: 500ms", "period: 20s").replace(
        "source: stereo,", "source: stereo, timeout: 300ms,")
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", *large, rate_hz=1, configure=configure) as drive:
        slowest = 0

        def given_up(pair):
            nonlocal slowest
            asked = time.monotonic()
            assert drive.ctl("status", "--json").returncode == 0
            assert "pairs" in drive.ctl("recalibrate", "front").stderr  # answered by the thread that waits for depth
            slowest = max(slowest, time.monotonic() - asked)
            return "depth_failed" in pair["skipped"]

        pair = drive.wait_for(given_up, 120 * slowdown)
        assert slowest < 2 * slowdown, f"{slowest} s for two answers"
        assert pair["evaluated"] == 0
        drive.ctl("status")
