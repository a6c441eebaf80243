"""calib-eval drift as a person meets it, on simulated streets and on recorded frames: results, errors, pictures."""

import json
import pathlib
import subprocess
import types

import numpy as np
import pytest
from PIL import Image

DONE, FAILED, USAGE = range(3)
AXES = ["roll", "pitch", "yaw", "x", "y", "z"]

COUNT = {"type": "integer", "minimum": 0}
NUMBER_OR_NULL = {"type": ["number", "null"], "minimum": 0}
SCHEMA = {
    "type": "object",
    "required": ["schema", "kind", "command", "recording", "settings", "axes", "null", "knocks", "timelines", "operating"],
    "properties": {
        "schema": {"const": 1},
        "kind": {"const": "drift"},
        "null": {
            "type": "object",
            "required": ["sequences", "decisions", "false_alarms", "rate_per_1000_vehicle_weeks", "upper95"],
            "properties": {"sequences": COUNT, "decisions": COUNT, "false_alarms": COUNT, "upper95": NUMBER_OR_NULL,
                           "rate_per_1000_vehicle_weeks": NUMBER_OR_NULL}},
        "knocks": {"type": "array", "minItems": 1, "items": {
            "type": "object",
            "required": ["axis", "magnitude", "sequences", "detected", "median_delay_pairs", "p95_delay_pairs", "estimate_error",
                         "estimate_sigma", "estimates", "estimates_within_2_sigma"],
            "properties": {"axis": {"enum": AXES}, "magnitude": {"type": "number"}, "sequences": COUNT, "detected": COUNT,
                           "median_delay_pairs": {"type": ["integer", "null"], "minimum": 1},
                           "p95_delay_pairs": {"type": ["integer", "null"], "minimum": 1},
                           "estimate_error": NUMBER_OR_NULL, "estimate_sigma": NUMBER_OR_NULL, "estimates": COUNT,
                           "estimates_within_2_sigma": COUNT}}}}}


@pytest.fixture(scope="module")
def drift(bin_dir, slowdown):
    """Runs calib-eval drift."""

    def run(*arguments):
        ended = subprocess.run([bin_dir / "calib-eval", "drift", *map(str, arguments)], capture_output=True, text=True,
                               timeout=120 * slowdown)
        return types.SimpleNamespace(exit=ended.returncode, out=ended.stdout, err=ended.stderr)

    return run


def result_of(drift, path, *arguments):
    """The result, and the lines on standard output."""
    ended = drift(*arguments, "--json", path)
    assert ended.exit == DONE, ended.err
    return json.loads(path.read_text()), ended.out.splitlines()


@pytest.fixture(scope="module")
def street(drift, tmp_path_factory):
    """Knocks in simulated streets: the result, its file and the lines on standard output."""
    path = tmp_path_factory.mktemp("street") / "r.json"
    result, lines = result_of(drift, path, "--sim", "--sim-places", 3, "--frames", 12, "--knock", "0.5deg,20cm", "--seeds", 40,
                              "--estimates", 1, "--weeks", 12)
    return types.SimpleNamespace(result=result, path=path, lines=lines)


def refusal(ended):
    """The one line that says why."""
    assert ended.exit == FAILED, ended.err
    (line,) = ended.err.splitlines()
    assert line.startswith("calib-eval: ")
    return line


def test_the_result_is_of_its_schema(street):
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.Draft202012Validator.check_schema(SCHEMA)
    jsonschema.Draft202012Validator(SCHEMA).validate(street.result)


def test_every_knock_is_found_in_simulated_streets(street):
    knocks = street.result["knocks"]
    assert [(knock["axis"], knock["magnitude"]) for knock in knocks] == [
        (axis, pytest.approx(side * size)) for axes, size in ((AXES[:3], 0.5), (AXES[3:], 20)) for axis in axes for side in (1, -1)]
    for knock in knocks:
        assert knock["sequences"] == 40 and knock["without_baseline"] == 0
        assert knock["detected"] == 40 and knock["median_delay_pairs"] <= (8 if knock["unit"] == "deg" else 30), knock["axis"]
        assert len(knock["delays"]) == 40
        assert knock["estimates"] == 1 and knock["estimate_error"] < 3 * knock["estimate_sigma"], knock["axis"]
        found = [delay for delay in knock["delays"] if delay is not None]
        assert knock["detected"] == len(found)
        assert all(20 <= before <= 120 for before in knock["moved_after"])
        assert knock["median_delay_pairs"] == sorted(found)[19] and knock["p95_delay_pairs"] == sorted(found)[37]


def test_no_false_alarm_is_raised_in_simulated_streets(street):
    null = street.result["null"]
    assert null["false_alarms"] == 0 and null["rate_per_1000_vehicle_weeks"] == 0
    assert null["sequences"] == 2 and null["vehicle_weeks"] == pytest.approx(12, rel=0.01)
    assert null["decisions"] + null["pairs_learning"] + null["pairs_without_power"] == 12 * 56 * 360
    assert null["upper95"] == pytest.approx(1000 * 2.9957 / null["vehicle_weeks"], rel=1e-4)


def test_the_text_says_what_the_result_says(street):
    text = "\n".join(street.lines)
    assert street.lines[0].startswith("12 frames") and "what none of them shows" in street.lines[1]
    assert "no false alarm: at most 250 in 1000 vehicle-weeks" in text
    table = street.lines[-12:]
    for line, knock in zip(table, street.result["knocks"]):
        assert line.startswith(knock["axis"]) and f"{knock['detected']} of 40" in line
    for axis in street.result["axes"]:
        assert 0 < axis["sigma_of_pair"] < axis["detection_limit"] * 2


def test_the_operating_curve_begins_at_the_setting_and_gets_quicker(street):
    points = street.result["operating"]
    assert [point["false_alerts_per_1000_vehicle_weeks"] for point in points] == [1, 10, 100, 1000, 10000, 100000]
    assert points[0]["null"] == street.result["null"]

    for strict, lax in zip(points[0]["knocks"], points[-1]["knocks"]):
        assert lax["detected"] >= strict["detected"]
        if strict["median_delay_pairs"] is not None:
            assert lax["median_delay_pairs"] <= strict["median_delay_pairs"]


def test_a_timeline_turns_to_drifted_after_the_knock(street):
    assert [entry["axis"] for entry in street.result["timelines"]] == AXES
    for entry in street.result["timelines"][:3]:
        verdicts = entry["verdict"]
        assert len(verdicts) == len(entry["evidence"])
        assert verdicts[0] == "learning" and "drifted" not in verdicts[:entry["moved_at"]]
        assert verdicts[-1] == "drifted" and max(entry["evidence"][-1]) >= 1


def test_the_result_is_drawn(bin_dir, street, tmp_path):
    drawn = subprocess.run([bin_dir / "calib-eval", "plot", street.path, "--out", tmp_path], capture_output=True, text=True,
                           timeout=120, check=True)
    assert [pathlib.Path(line).name for line in drawn.stdout.splitlines()] == ["timelines.png", "delays.png", "operating.png"]
    for line in drawn.stdout.splitlines():
        pixels = np.asarray(Image.open(line).convert("L"), float)
        assert min(pixels.shape) > 200 and pixels.std() > 10, line


SMALL = ["--sim", "--sim-places", 2, "--frames", 8, "--seeds", 5, "--weeks", 2, "--estimates", 0]


def test_the_same_seed_gives_the_same_result_with_any_number_of_threads(drift, tmp_path):
    one, three = (result_of(drift, tmp_path / "r.json", *SMALL, "--knock", "0.5deg", "--threads", threads) for threads in (1, 3))
    assert one == three
    other = result_of(drift, tmp_path / "r.json", *SMALL, "--knock", "0.5deg", "--seed", 2)
    assert other[0]["axes"] != one[0]["axes"]


def test_a_lidar_that_creeps_is_found(drift, tmp_path):
    result, lines = result_of(drift, tmp_path / "r.json", *SMALL, "--depth", "true", "--rate", 6, "--pairs", 40)
    assert [knock["axis"] for knock in result["knocks"]] == ["roll", "roll", "pitch", "pitch", "yaw", "yaw"]
    for knock in result["knocks"]:
        assert knock["unit"] == "deg/h" and knock["detected"] == 5
        assert 5 < knock["median_delay_pairs"] <= 40
    assert any(line.startswith("yaw    -6 deg/h") for line in lines)


@pytest.fixture(scope="module")
def recording(bin_dir, tmp_path_factory):
    """A drive in KITTI's layout, of nine frames."""
    ended = subprocess.run([bin_dir / "calib-sim", "--dump", tmp_path_factory.mktemp("drive"), "--rate", "0.2", "--width", "480",
                            "--height", "144", "--frames", "9", "--lidar-step-deg", "0.4", "--lidar-fov-deg", "140"],
                           capture_output=True, text=True, timeout=250, check=True)
    return ["--dataset", "kitti-raw", "--root", json.loads(ended.stdout.splitlines()[-1])["drive"], "--depth", "stereo"]


def test_recorded_frames_are_resampled_too(drift, recording, tmp_path):
    result, lines = result_of(drift, tmp_path / "r.json", *recording, "--knock", "1deg", "--seeds", 10, "--weeks", 1, "--block", 4,
                              "--estimates", 2)
    assert lines[0].startswith("9 frames") and "4 neighbours at a time" in lines[1]
    assert result["settings"]["block"] == 4 and len(result["recording"]["frames"]) == 9
    assert [knock["detected"] for knock in result["knocks"]] == [10] * 6
    assert result["null"]["false_alarms"] == 0


def test_too_few_frames_are_told(drift, recording):
    assert "7 frames can be used, and at least 8 are needed" in refusal(drift(*recording, "--frames", 7))


def test_blocks_that_leave_nothing_to_draw_are_told(drift, recording):
    assert "--block 5 is more than half of the 9 frames" in refusal(drift(*recording, "--block", 5))


def test_a_result_that_cannot_be_written_is_told_before_any_work(drift, recording, tmp_path):
    ended = drift(*recording, "--json", tmp_path / "missing" / "r.json")
    assert "cannot be written" in refusal(ended) and ended.out == ""


@pytest.mark.parametrize("arguments, told", [
    ([], "--dataset or --sim"),
    (["--sim", "--knock", "0deg"], "more than nothing"),
    (["--sim", "--knock", "0.5"], "more than nothing"),
    (["--sim", "--knock", "9deg"], "up to 5deg"),
    (["--sim", "--knock", "0.5deg", "--rate", "1"], "--rate"),
    (["--sim", "--rate", "0"], "--rate"),
    (["--sim", "--dataset", "list", "--root", "x"], "--sim"),
    (["--sim", "--depth-dir", "x", "--depth-kind", "depth"], "--depth-dir"),
    (["--sim", "--camera", "image_02"], "--camera"),
    (["--sim", "--weeks", "0"], "--weeks"),
    (["--sim", "--weeks", "nan"], "--weeks"),
    (["--sim", "--rate", "nan"], "--rate"),
    (["--sim", "--period-s", "nan"], "--period-s"),
    (["--sim", "--false-alerts-per-1000-vehicle-weeks", "nan"], "--false-alerts-per-1000-vehicle-weeks"),
    (["--sim", "--pairs", "1"], "--pairs"),
    (["--sim", "--seeds", "0"], "--seeds"),
    (["--sim", "--frames", "2"], "--frames"),
    (["--sim-places", "3", "--dataset", "list", "--root", "x", "--depth", "stereo"], "--sim"),
    (["--dataset", "list", "--depth", "stereo"], "--root"),
    (["--dataset", "list", "--root", "x"], "--depth"),
    (["--dataset", "list", "--root", "x", "--depth", "true"], "--sim"),
    (["--dataset", "kitti-360", "--root", "x", "--depth", "stereo"], "--drive")])
def test_what_makes_no_sense_is_a_usage_error(drift, arguments, told):
    ended = drift(*arguments)
    assert ended.exit == USAGE and told in ended.err, ended.err
    assert ended.out == ""


def test_real_frames_raise_no_alarm_and_half_a_degree_does(drift, kitti_drive, tmp_path):
    result, _ = result_of(drift, tmp_path / "r.json", "--dataset", "kitti-raw", "--root", kitti_drive, "--depth-dir",
                          kitti_drive / "depth/stereo_net", "--depth-kind", "disparity", "--knock", "0.5deg", "--seeds", 50,
                          "--weeks", 50)
    assert result["null"]["false_alarms"] == 0
    for knock in result["knocks"]:
        assert knock["detected"] == 50 and knock["median_delay_pairs"] <= 5
