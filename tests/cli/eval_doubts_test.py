"""calib-eval says when a result is not to be believed, and ends with 4 then where that is asked for."""

import json
import subprocess

import pytest

DONE, DOUBTFUL = 0, 4


@pytest.fixture(scope="module")
def drive(bin_dir, tmp_path_factory):
    """Options that name a simulated drive of ten frames and its true depth."""
    ended = subprocess.run([bin_dir / "calib-sim", "--dump", tmp_path_factory.mktemp("drive"), "--rate", "0.2", "--camera",
                            "fisheye-double-sphere", "--size", "240x240", "--frames", "10", "--lidar-step-deg", "1"],
                           capture_output=True, text=True, timeout=250, check=True)
    said = json.loads(ended.stdout.splitlines()[-1])
    return ["--dataset", "list", "--root", said["recording"], "--depth-dir", said["depth"], "--depth-kind", "range"]


def codes(doubts):
    return [doubt["code"] for doubt in doubts]


def test_a_sound_result_has_no_doubt(evaluate, drive, tmp_path):
    ended = evaluate("calibrate", *drive, "--rotation-deg", 1, "--starts", 3, "--strict", "--json", tmp_path / "r.json")
    assert ended.exit == DONE, ended.out + ended.err
    assert "believed" not in ended.out
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["doubts"] == [] and result["cells"][0]["doubts"] == []
    assert "--strict" not in result["command"], "it changes nothing in the result"


def test_doubts_are_told_in_words_and_codes_and_strict_ends_with_4(evaluate, drive, tmp_path):
    command = ["calibrate", *drive, "--rotation-deg", 1, "--starts", 1, "--frames", 4, "--json", tmp_path / "r.json"]
    for options, status in ((command, DONE), ([*command, "--strict"], DOUBTFUL)):
        ended = evaluate(*options)
        assert ended.exit == status and ended.err == "", ended.err
        assert "4 frames are few" in ended.out and "[few_frames]" in ended.out
        assert "one search does not show whether others end at the same extrinsic [not_repeatable]" in ended.out
        assert ended.out.splitlines()[-1] == "The result is not to be believed: few_frames, not_repeatable"
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["complete"]
    assert codes(result["doubts"]) == ["few_frames"] and codes(result["cells"][0]["doubts"]) == ["not_repeatable"]
    assert all(doubt["words"] for doubt in result["doubts"])


def test_every_command_that_computes_takes_strict(evaluate, drive, tmp_path):
    few = [*drive, "--frames", 9, "--strict"]
    assert evaluate("curve", *few, "--points", 3, "--dof", 3).exit == DOUBTFUL
    assert evaluate("surface", *few, "--points", 3, "--axes", "roll:yaw", "--json", tmp_path / "s.json").exit == DOUBTFUL
    assert codes(json.loads((tmp_path / "s.json").read_text())["doubts"]) == ["few_frames"]
    assert evaluate("curve", *drive, "--strict", "--points", 3, "--dof", 3).exit == DONE
    assert evaluate("drift", *few, "--knock", "1deg", "--seeds", 1, "--weeks", 0.01, "--estimates", 0).exit == DOUBTFUL


def test_depth_of_another_kind_is_a_doubt(evaluate, drive):
    ended = evaluate("calibrate", *drive[:-1], "disparity", "--rotation-deg", 1, "--starts", 2, "--strict")
    assert ended.exit == DOUBTFUL
    assert "low_agreement" in ended.out.splitlines()[-1]
