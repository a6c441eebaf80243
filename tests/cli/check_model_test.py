"""`calibctl check-model` as a person meets it: the network that calibd brings, on a simulated drive, and descriptors of it
that are wrong in one way each."""

import hashlib
import json
import pathlib
import shutil
import subprocess

import numpy as np
import onnx
import pytest
from onnx import helper, numpy_helper

from conftest import DONE, FAILED, NO, NOT_FOUND, USAGE


@pytest.fixture(scope="module")
def drive(bin_dir, tmp_path_factory):
    made = subprocess.run([bin_dir / "calib-sim", "--dump", tmp_path_factory.mktemp("drive"), "--frames", "2", "--rate", "0.2",
                           "--lidar-step-deg", "0.4", "--lidar-fov-deg", "140"], capture_output=True, text=True, check=True,
                          timeout=120)
    return pathlib.Path(json.loads(made.stdout.splitlines()[-1])["drive"])


@pytest.fixture
def network(source_dir, tmp_path):
    """A copy of the network's files; `edit` replaces text of the descriptor."""
    for file in (source_dir / "libcalib/models").iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path / "street-small.yaml"


def edit(descriptor, *replacements):
    text = descriptor.read_text()
    for old, new in replacements:
        assert old in text
        text = text.replace(old, new)
    descriptor.write_text(text)


def without_golden_pair(descriptor):
    text = descriptor.read_text()
    descriptor.write_text(text[:text.index("golden:")])


def rewrite(descriptor, change):
    """Changes the network itself, and the hash with it."""
    file = descriptor.with_suffix(".onnx")
    model = onnx.load(file)
    change(model.graph)
    old = hashlib.sha256(file.read_bytes()).hexdigest()
    onnx.save(model, file)
    edit(descriptor, (old, hashlib.sha256(file.read_bytes()).hexdigest()))


def suspicions(said):
    return {one["code"]: one["remedy"] for one in json.loads(said.out)["suspicions"]}


def test_the_network_that_comes_with_calibd_passes(bare, network):
    said = bare("check-model", network)
    assert (said.exit, said.err) == (DONE, "")
    assert "passed: the golden output" in said.out and "inverse depth without a scale" in said.out
    assert "Suspicions      : none" in said.out


def test_on_a_frame_it_says_what_the_depth_is_like(bare, network, drive):
    said = bare("check-model", network, "--recording", drive, "--frame", "1", "--json")
    assert (said.exit, said.err) == (DONE, "")
    report = json.loads(said.out)
    assert (report["input"]["width"], report["input"]["height"]) == (320, 96)
    assert report["lidar"]["rank_correlation"] > 0.7 and report["lidar"]["points"] > 1000
    assert report["lower_over_upper"] > 1 and 0.5 < report["valid_share"] <= 1 and report["run_ms"] > 0
    depth = list(report["depth"].values())
    assert depth == sorted(depth) and report["unit"] is None


def test_an_image_with_a_cloud_says_the_same_as_the_recording(bare, network, drive):
    P, T, R = ([float(number) for number in next(line for line in file.read_text().splitlines() if line.startswith(key))
                .split()[1:]] for file, key in ((drive.parent / "calib_cam_to_cam.txt", "P_rect_02"),
                                                (drive.parent / "calib_velo_to_cam.txt", "T:"),
                                                (drive.parent / "calib_velo_to_cam.txt", "R:")))
    R = np.array(R).reshape(3, 3)
    w = np.sqrt(1 + np.trace(R)) / 2
    q = [(R[2, 1] - R[1, 2]) / 4 / w, (R[0, 2] - R[2, 0]) / 4 / w, (R[1, 0] - R[0, 1]) / 4 / w, w]
    by_files = bare("check-model", network, "--json", "--image", drive / "image_02/data/0000000001.png",
                    "--camera", f"rectified:{P[0]},{P[5]},{P[2]},{P[6]}",
                    "--cloud", drive / "velodyne_points/data/0000000001.bin",
                    "--T-camera-lidar", ",".join(map(str, [*T, *q])))
    by_recording = bare("check-model", network, "--json", "--recording", drive, "--frame", "1")
    assert json.loads(by_files.out)["lidar"] == pytest.approx(json.loads(by_recording.out)["lidar"], abs=1e-6)


@pytest.mark.parametrize("with_cloud", [True, False], ids=["by the cloud", "by the order of rows"])
def test_inverse_depth_that_is_declared_as_depth_is_suspicious(bare, network, drive, with_cloud):
    edit(network, ("inverse_relative", "depth_relative"))
    frame = ["--recording", drive] if with_cloud else ["--image", drive / "image_02/data/0000000000.png"]
    said = bare("check-model", network, *frame, "--json")
    assert said.exit == NO
    assert "write output.semantics: inverse_relative" in suspicions(said)["depth_inverted"]
    assert "SUSPICION       : near and far" in bare("check-model", network, *frame).out


def test_metres_that_are_not_metres_are_suspicious(bare, network, drive):
    def times(factor):
        def change(graph):
            graph.initializer.append(numpy_helper.from_array(np.float32(factor), "factor"))
            exp = next(node for node in graph.node if node.op_type == "Exp")
            exp.output[0] = "inverse"
            graph.node.append(helper.make_node("Div", ["factor", "inverse"], ["inverse_depth"]))
        return change

    without_golden_pair(network)
    edit(network, ("inverse_relative", "depth_metric"), ("[0.0025, 10]", "[0.1, 4000]"))
    box = network.with_suffix(".onnx").read_bytes()
    rewrite(network, times(1))
    first = bare("check-model", network, "--recording", drive, "--json")
    ratio = json.loads(first.out)["lidar"]["lidar_over_network"]
    for factor, expected in ((ratio, DONE), (3 * ratio, NO)):
        text = network.read_text()
        old = hashlib.sha256(network.with_suffix(".onnx").read_bytes()).hexdigest()
        network.with_suffix(".onnx").write_bytes(box)
        network.write_text(text.replace(old, hashlib.sha256(box).hexdigest()))
        rewrite(network, times(factor))
        said = bare("check-model", network, "--recording", drive, "--json")
        assert said.exit == expected, said.out
    assert "canonical_focal_px" in suspicions(said)["not_metric"]


def test_a_normalisation_that_does_not_go_with_the_scale_is_suspicious(bare, network, drive):
    without_golden_pair(network)
    edit(network, ("scale: 1/255", "scale: 1/255\n  mean: [123.675]\n  std: [58.395]"))
    said = bare("check-model", network, "--recording", drive, "--json")
    assert said.exit == NO and "write scale: 1" in suspicions(said)["normalisation"]
    assert "names no golden pair" in json.loads(said.out)["remark"]


def test_a_range_that_holds_hardly_a_pixel_is_suspicious(bare, network, drive):
    edit(network, ("[0.0025, 10]", "[0.5, 10]"))
    said = bare("check-model", network, "--recording", drive, "--json")
    assert said.exit == NO and "valid_range" in suspicions(said)["few_valid_depth"]


@pytest.mark.parametrize("fault, words", [
    (lambda yaml: yaml.with_suffix(".onnx").write_bytes(yaml.with_suffix(".onnx").read_bytes() + b"x"), "SHA-256"),
    (lambda yaml: edit(yaml, ("channel_order: grey", "channel_order: rgb")), "channel"),
    (lambda yaml: edit(yaml, ("name: image", "name: pixel_values")), "pixel_values"),
    (lambda yaml: edit(yaml, ("scale: 1/255", "scale: 1/255\n  mean: [0.5]\n  std: [-1]")), "input.std"),
    (lambda yaml: yaml.with_name("street-small-golden.f32").write_bytes(bytes(4)), "self-test failed"),
    (lambda yaml: edit(yaml, ("semantics: inverse_relative", "semantics: inverse")), "is none of: inverse_relative"),
], ids=["hash", "channels", "input name", "standard deviation", "golden output", "semantics"])
def test_what_calibd_would_refuse_is_refused_with_one_line(bare, network, fault, words):
    fault(network)
    said = bare("check-model", network)
    assert (said.exit, said.out) == (FAILED, "")
    assert words in said.err and said.err.startswith("calibctl: ") and said.err.count("\n") == 1


def test_what_is_missing_is_named(bare, network, drive):
    assert bare("check-model").exit == USAGE
    assert bare("check-model", network, "--cloud", "x.bin").exit == USAGE
    assert bare("check-model", network.with_name("other.yaml")).exit == NOT_FOUND
    assert bare("check-model", network, "--recording", drive, "--frame", "9").exit == NOT_FOUND
    assert bare("check-model", network, "--image", network).exit == FAILED
    assert "--recording" in bare("check-model", "--help").out


def test_without_the_program_that_checks_calibctl_says_so(bin_dir, tmp_path, network):
    shutil.copy(bin_dir / "calibctl", tmp_path)
    ended = subprocess.run([tmp_path / "calibctl", "check-model", network], capture_output=True, text=True, check=False,
                           env={"PATH": "/nowhere"})
    assert ended.returncode == NOT_FOUND and "no calib-check-model beside calibctl" in ended.stderr
