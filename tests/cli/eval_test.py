"""calib-eval as a person meets it, on a small simulated drive: results, errors, pictures."""

import json
import os
import pathlib
import re
import shutil
import subprocess
import types

import numpy as np
import pytest
from PIL import Image

DONE, FAILED, USAGE = range(3)


def dump(bin_dir, folder, *options):
    """What calib-sim says of the recording that it has written."""
    ended = subprocess.run([bin_dir / "calib-sim", "--dump", folder, "--rate", "0.2", *options], capture_output=True, text=True,
                           timeout=250, check=True)
    return json.loads(ended.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def stereo(bin_dir, tmp_path_factory):
    """Options that name a drive in KITTI's layout and its stereo depth."""
    said = dump(bin_dir, tmp_path_factory.mktemp("stereo"), "--width", "480", "--height", "144", "--frames", "5",
                "--lidar-step-deg", "0.4", "--lidar-fov-deg", "140")
    return ["--dataset", "kitti-raw", "--root", said["drive"], "--depth", "stereo"]


@pytest.fixture(scope="module")
def fisheye(bin_dir, tmp_path_factory):
    """Options that name a list with true depth, seen through a fisheye."""
    said = dump(bin_dir, tmp_path_factory.mktemp("fisheye"), "--camera", "fisheye-double-sphere", "--size", "240x240",
                "--frames", "4", "--lidar-step-deg", "1")
    return ["--dataset", "list", "--root", said["recording"], "--depth-dir", said["depth"], "--depth-kind", "range"]


@pytest.fixture
def own_list(fisheye, tmp_path):
    """A copy of the list, to be damaged."""
    folder = tmp_path / "list"
    shutil.copytree(pathlib.Path(fisheye[3]).parent, folder)
    return types.SimpleNamespace(folder=folder, yaml=folder / "recording.yaml",
                                 options=["--dataset", "list", "--root", folder / "recording.yaml",
                                          "--depth-dir", folder / "depth", "--depth-kind", "range"])


def without_times(result):
    for entry in result["cells"]:
        del entry["seconds_per_run"]
    for entry in result["runs"]:
        del entry["seconds"]
    return result["cells"], result["runs"]


def assert_a_picture(path):
    pixels = np.asarray(Image.open(path).convert("L"), float)
    assert pixels.shape[0] > 200 and pixels.shape[1] > 200, path
    assert pixels.std() > 10, f"{path} is blank"


def refusal(ended):
    """The one line that says why."""
    assert ended.exit == FAILED, ended.err
    (line,) = ended.err.splitlines()
    assert line.startswith("calib-eval: ")
    return line


# --- calibrate ---

def test_small_errors_are_found_by_every_objective_but_the_weakest(evaluate, stereo, tmp_path):
    ended = evaluate("calibrate", *stereo, "--objective", "default,d2d", "--objective", "i2i_nmi", "--rotation-deg", 1,
                     "--starts", 6, "--json", tmp_path / "r.json")
    assert ended.exit == DONE and ended.err == "", ended.err
    cells = json.loads((tmp_path / "r.json").read_text())["cells"]
    assert [cell["objective"] for cell in cells] == ["default", "d2d", "i2i_nmi"]
    assert cells[0]["hits"] == 6 and cells[0]["hit_rotation_error_deg"] < 0.1
    assert cells[1]["hits"] >= 4
    heading, *lines = [line for line in ended.out.splitlines()[1:] if not line.startswith(("  ", "The result"))]
    assert "rotation error" in heading and len(lines) == 3
    assert lines[0].split()[:7] == ["default", "3", "1", "deg", "-", "100.0", "%"]


def test_rotation_and_translation_are_found_together(evaluate, stereo, tmp_path):
    ended = evaluate("calibrate", *stereo, "--dof", 6, "--rotation-deg", 1, "--translation-cm", "0,25", "--starts", 5,
                     "--json", tmp_path / "r.json")
    assert ended.exit == DONE, ended.err
    cells = json.loads((tmp_path / "r.json").read_text())["cells"]
    assert [cell["translation_cm"] for cell in cells] == [0, 25]
    for cell in cells:
        assert cell["hits"] == 5 and cell["hit_translation_error_cm"] < 5
        assert cell["best"]["observable"] == [True] * 6
        assert all(sigma > 0 for sigma in cell["best"]["sigma_by_bootstrap"])


def test_any_orientation_is_found_through_a_fisheye(evaluate, fisheye, tmp_path):
    ended = evaluate("calibrate", *fisheye, "--rotation-deg", "20,180", "--starts", 3, "--json", tmp_path / "r.json")
    assert ended.exit == DONE, ended.err
    result = json.loads((tmp_path / "r.json").read_text())
    assert [cell["hits"] for cell in result["cells"]] == [3, 3]
    assert result["recording"]["camera"]["model"] == "double_sphere"
    assert re.search(r"^default +3 +any ", ended.out, re.MULTILINE)


def test_the_result_says_all_that_its_summary_comes_from(evaluate, stereo, tmp_path):
    assert evaluate("calibrate", *stereo, "--rotation-deg", "2", "--starts", 5, "--frames", 4, "--seed", 9, "--threads", 2,
                    "--json", tmp_path / "r.json").exit == DONE
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["schema"] == 1 and result["kind"] == "calibrate" and result["complete"] and result["seed"] == 9
    assert result["command"] == ["calib-eval", "calibrate", *stereo, "--rotation-deg", "2", "--starts", "5", "--frames", "4",
                                 "--seed", "9"]
    assert len(result["recording"]["frames"]) == 4 and result["recording"]["left_out"] == []
    agreement = result["recording"]["depth_agreement"]
    assert agreement["rank_correlation"] > 0.9 and agreement["frames"] == agreement["own_cloud_better"] == 4
    (cell,) = result["cells"]
    assert (cell["starts"], cell["dof"], cell["rotation_deg"], cell["translation_cm"]) == (5, 3, 2, 0)
    runs = result["runs"]
    assert [run["run"] for run in runs] == list(range(5)) and {run["cell"] for run in runs} == {0}
    assert cell["hits"] == sum(run["hit"] for run in runs) and cell["hit_rate"] == cell["hits"] / 5
    for run in runs:
        assert np.linalg.norm(run["start"][:3]) == pytest.approx(2, rel=1e-6) and run["start"][3:] == [0, 0, 0]
        assert run["hit"] == (run["rotation_error_deg"] < 0.5)
        assert run["score_after"] > run["score_before"]
    ends = np.array([run["end"] for run in runs])
    assert cell["all_mean"] == pytest.approx(ends.mean(axis=0), abs=1e-9)
    assert cell["all_std"] == pytest.approx(ends.std(axis=0, ddof=1), abs=1e-9)
    assert cell["hit_rotation_error_deg"] == pytest.approx(np.mean([run["rotation_error_deg"] for run in runs if run["hit"]]))


def test_the_same_seed_gives_the_same_result_with_any_number_of_threads(evaluate, stereo, tmp_path):
    results = []
    for threads, seed in ((1, 1), (3, 1), (3, 2)):
        path = tmp_path / f"{threads}.json"
        assert evaluate("calibrate", *stereo, "--rotation-deg", "1,180,1.0", "--depth-bias", 0.2, "--starts", 3, "--threads",
                        threads, "--seed", seed, "--json", path).exit == DONE
        results.append(without_times(json.loads(path.read_text())))
    assert results[0] == results[1]
    of_one, of_another = (runs for _, runs in results[1:])
    assert len(of_one) == 6, "1.0 is 1 once more"
    assert of_one[3]["start"] != of_another[3]["start"] and of_one[0]["start"] == of_another[0]["start"]


def test_progress_is_shown_on_a_terminal(bin_dir, stereo):
    ours, terminal = os.openpty()
    ended = subprocess.run([bin_dir / "calib-eval", "calibrate", *stereo, "--rotation-deg", "1", "--starts", "2"],
                           stdout=subprocess.PIPE, stderr=terminal, text=True, timeout=250, check=True)
    os.close(terminal)
    shown = os.read(ours, 65536).decode()
    os.close(ours)
    assert "default, 1 deg, 0 cm [....." in shown and "0 of 2" in shown
    assert shown.endswith("\x1b[K"), "the bar is gone in the end"
    assert "[..." not in ended.stdout


def test_biased_depth_is_worse_depth(evaluate, fisheye, tmp_path):
    scores = []
    for bias in (0, 0.5):
        path = tmp_path / f"{bias}.json"
        assert evaluate("curve", *fisheye, "--depth-bias", bias, "--points", 3, "--json", path).exit == DONE
        scores.append(json.loads(path.read_text())["curves"][0]["score"][1])
    assert scores[1] < scores[0]


# --- curve, surface, plot ---

def test_scores_are_best_near_the_truth(evaluate, stereo, tmp_path):
    ended = evaluate("curve", *stereo, "--objective", "default,i2i", "--points", 11, "--json", tmp_path / "c.json")
    assert ended.exit == DONE, ended.err
    result = json.loads((tmp_path / "c.json").read_text())
    assert result["kind"] == "curve"
    curves = {(curve["objective"], curve["axis"]): curve for curve in result["curves"]}
    assert len(curves) == 12
    for axis in ("roll", "pitch", "yaw"):
        curve = curves["default", axis]
        assert curve["unit"] == "deg" and curve["offset"][::5] == [-5, 0, 5]
        assert np.argmax(curve["score"]) == 5
    assert "default scores best at roll 0 deg" in ended.out
    assert evaluate("plot", tmp_path / "c.json").out.split() == [str(tmp_path / "c" / "curves.png")]
    assert_a_picture(tmp_path / "c" / "curves.png")


def test_a_surface_crosses_the_curves_in_the_middle(evaluate, fisheye, tmp_path):
    for command in (["curve"], ["surface", "--axes", "pitch:z,yaw:roll"]):
        ended = evaluate(*command, *fisheye, "--points", 5, "--range-deg", 2, "--range-cm", 40, "--json",
                         tmp_path / f"{command[0]}.json")
        assert ended.exit == DONE, ended.err
    curves = {curve["axis"]: curve for curve in json.loads((tmp_path / "curve.json").read_text())["curves"]}
    surfaces = json.loads((tmp_path / "surface.json").read_text())["surfaces"]
    assert [surface["axes"] for surface in surfaces] == [["pitch", "z"], ["yaw", "roll"]]
    for surface in surfaces:
        score = np.array(surface["score"])
        assert surface["offset"][0] == curves[surface["axes"][0]]["offset"]
        assert list(score[:, 2]) == curves[surface["axes"][0]]["score"]
        assert list(score[2]) == curves[surface["axes"][1]]["score"]
    drawn = evaluate("plot", tmp_path / "surface.json", "--out", tmp_path / "pictures")
    assert drawn.exit == DONE, drawn.err
    assert_a_picture(tmp_path / "pictures" / "surfaces_default.png")


def test_figures_show_a_run_before_and_after(evaluate, stereo, tmp_path):
    ended = evaluate("calibrate", *stereo, "--dof", 6, "--objective", "default,i2i", "--rotation-deg", 1, "--translation-cm", 25,
                     "--starts", 3, "--json", tmp_path / "r.json", "--figures", tmp_path / "shots")
    assert ended.exit == DONE, ended.err
    figures = json.loads((tmp_path / "r.json").read_text())["figures"]
    assert [figure["features"] for figure in figures] == ["depth", "intensity"]
    for figure in figures:
        before, after, truth = figure["views"]
        assert [view["view"] for view in figure["views"]] == ["start", "end", "truth"]
        for view in figure["views"]:
            assert len(view["histogram"]) == figure["classes"] ** 2 and sum(view["histogram"]) > 500
            assert (tmp_path / view["overlay"]).is_file()
    before, after, truth = figures[0]["views"]
    assert after["score"] > before["score"] and after["score"] == pytest.approx(truth["score"], abs=0.01)
    (tmp_path / figures[1]["views"][0]["overlay"]).unlink()

    drawn = evaluate("plot", tmp_path / "r.json", "--out", tmp_path / "pictures")
    assert figures[1]["views"][0]["overlay"] in refusal(drawn), "what is there is drawn all the same"
    names = {pathlib.Path(line).name for line in drawn.out.splitlines()}
    cell = "default_6dof_1deg_25cm.png"
    assert {f"bullseye_rotation_{cell}", f"bullseye_translation_{cell}", f"histograms_{cell}", f"overlay_{cell}",
            "hits_6dof.png"} < names
    for line in drawn.out.splitlines():
        assert_a_picture(line)


@pytest.mark.parametrize("text", ["no json", "[]", '{"schema": 2, "kind": "curve"}', '{"schema": 1, "kind": "song"}',
                                  '{"schema": 1, "kind": "curve"}', '{"schema": 1, "kind": "calibrate", "cells": []}'])
def test_plot_refuses_what_is_no_result_in_one_line(evaluate, tmp_path, text):
    (tmp_path / "r.json").write_text(text)
    refusal(evaluate("plot", tmp_path / "r.json"))


# --- bad recordings, bad words ---

def set_quaternion(own_list, change):
    text = own_list.yaml.read_text()
    numbers = re.search(r"quaternion_xyzw: \[(.*)\]", text)[1]
    own_list.yaml.write_text(text.replace(numbers, ", ".join(map(str, change(*map(float, numbers.split(", ")))))))


def test_an_extrinsic_of_the_wrong_direction_is_told(evaluate, own_list):
    set_quaternion(own_list, lambda x, y, z, w: (-x, -y, -z, w))
    assert "inverse, T_lidar_camera" in refusal(evaluate("calibrate", *own_list.options))


def test_what_contradicts_the_depth_is_told_and_evaluated_all_the_same(evaluate, own_list):
    def told():
        ended = evaluate("curve", *own_list.options, "--points", 3, "--dof", 3)
        assert ended.exit == DONE, ended.err
        return ended.err

    assert not told()
    own_list.options[-1] = "disparity"
    assert "rank correlation -0" in told() and "--depth-kind" in told()
    own_list.options[-1] = "range"
    set_quaternion(own_list, lambda x, y, z, w: (w, x, y, z))
    assert "order w, x, y, z" in told()


def test_frames_that_lack_something_are_told(evaluate, own_list):
    clouds, images = (sorted((own_list.folder / name).iterdir()) for name in ("clouds", "images"))
    clouds[0].unlink()
    ended = evaluate("curve", *own_list.options, "--points", 3, "--dof", 3)
    assert ended.exit == DONE and ended.err == f"calib-eval: 1 of 4 frames are left out: no cloud for {clouds[0].stem}\n"
    images[3].unlink()
    assert refusal(evaluate("curve", *own_list.options)).endswith(
        f"2 of 4 frames can be used, and 3 are needed: no cloud for {clouds[0].stem}, no image for {images[3].stem}")


def test_an_empty_cloud_is_told(evaluate, own_list):
    cloud = sorted((own_list.folder / "clouds").iterdir())[-1]
    cloud.write_bytes(b"")
    assert cloud.name in refusal(evaluate("calibrate", *own_list.options))


def test_what_is_not_there_is_told(evaluate, fisheye, tmp_path):
    assert "right images" in refusal(evaluate("calibrate", *fisheye[:4], "--depth", "stereo"))
    refusal(evaluate("surface", "--dataset", "list", "--root", tmp_path / "none.yaml", "--depth", "stereo", "--json",
                     tmp_path / "s.json"))
    assert not (tmp_path / "s.json").exists()


def test_a_frame_without_depth_is_left_out_and_too_few_are_too_few(evaluate, own_list):
    depths = sorted((own_list.folder / "depth").iterdir())
    depths[0].unlink()
    ended = evaluate("calibrate", *own_list.options, "--rotation-deg", 1, "--starts", 1)
    assert ended.exit == DONE and ended.out.startswith("3 frames")
    (line,) = ended.err.splitlines()
    assert depths[0].stem in line and "left out" in line
    depths[1].unlink()
    assert "2 of 4 frames can be used" in refusal(evaluate("calibrate", *own_list.options))


@pytest.fixture(scope="module")
def networks(bin_dir):
    """Small networks that take brightness for nearness, and broken ones: see support/make_depth_models.py."""
    return bin_dir.parent / "tests/depth_models"


def test_depth_from_a_network_is_the_same_with_any_number_of_threads(evaluate, stereo, networks, tmp_path):
    scores = []
    for threads in (1, 2):
        ended = evaluate("curve", *stereo[:4], "--depth", f"onnx:{networks / 'depth_anything.yaml'}", "--points", 3, "--dof", 3,
                         "--frames", 3, "--threads", threads, "--json", tmp_path / "c.json")
        assert ended.exit == DONE and "depth does not grow with the LiDAR's range" in ended.err, "brightness is no depth"
        result = json.loads((tmp_path / "c.json").read_text())
        assert abs(result["recording"]["depth_agreement"]["rank_correlation"]) < 0.5
        assert result["recording"]["depth"]["source"].startswith("onnx:") and len(result["recording"]["frames"]) == 3
        scores.append([curve["score"] for curve in result["curves"]])
    assert scores[0] == scores[1]


def test_a_network_that_nothing_proves_is_told(evaluate, fisheye, networks):
    ended = evaluate("curve", *fisheye[:4], "--depth", f"onnx:{networks / 'good.yaml'}", "--points", 3, "--dof", 3)
    assert ended.exit == DONE and "good.yaml names no golden pair" in ended.err


def test_a_wrong_network_is_told(evaluate, fisheye, networks, tmp_path):
    def told(descriptor):
        return refusal(evaluate("curve", *fisheye[:4], "--depth", f"onnx:{descriptor}", "--points", 3))

    assert "nowhere.yaml: cannot be read" in told(tmp_path / "nowhere.yaml")
    (tmp_path / "wrong.yaml").write_text("file: x.onnx\nsha: 12\n")
    assert f"{tmp_path}/wrong.yaml:2: sha: unknown key" in told(tmp_path / "wrong.yaml")
    assert "external.onnx: keeps its weights in other files" in told(networks / "external.yaml")


def test_a_result_that_cannot_be_written_is_told(evaluate, fisheye, tmp_path):
    assert "cannot be written" in refusal(evaluate("curve", *fisheye, "--json", tmp_path / "missing" / "c.json"))
    ended = evaluate("calibrate", *fisheye, "--starts", 1, "--json", tmp_path / "missing" / "c.json")
    assert "cannot be written" in refusal(ended) and ended.out == "", "before any search"
    (tmp_path / "file").touch()
    ended = evaluate("calibrate", *fisheye, "--json", tmp_path / "c.json", "--figures", tmp_path / "file" / "shots")
    assert f"{tmp_path}/file/shots: Not a directory" in refusal(ended) and ended.out == "", "before any search"


STEREO = "--dataset list --root x --depth stereo "


@pytest.mark.parametrize("arguments, told", [
    ("", "subcommand"), ("plot none.json", "none.json"), ("calibrate", "--dataset"), ("surface " + STEREO, "--json"),
    *((f"calibrate --root x --dataset {options}", told) for options, told in [
        ("kitti-raw", "--depth"), ("waymo --depth stereo", "kitti-360"), ("list --depth guess", "stereo"),
        ("kitti-360 --depth stereo", "--drive"), ("list --depth-dir x", "--depth-kind"),
        ("list --depth-dir x --depth-kind colour", "colour")]),
    *((f"calibrate {STEREO}{options}", told) for options, told in [
        ("--depth-scale 2", "--depth-dir"), ("--camera image_02", "--camera"), ("--objective d2d,best", "i2i_nmi"),
        ("--rotation-deg 120", "120"), ("--rotation-deg many", "many"), ("--rotation-deg 1,,2", "a comma too many"),
        ("--translation-cm 25", "--dof 6"), ("--dof 6 --translation-cm nan", "nan"), ("--dof 4", "4"), ("--frames 2", "2"),
        ("--figures f", "--json"), ("--depth-bias nan", "--depth-bias: nan is not a number from 0 to 0.99"), ("--seed -1", "-1"),
        ("--starts 1e3", "whole number")]),
    *((f"curve {STEREO}{options}", told) for options, told in [
        ("--range-deg nan", "nan"), ("--range-cm inf", "inf"), ("--points 40", "odd number")]),
    (f"surface {STEREO}--json j --axes up:down", "up:down")])
def test_nonsense_is_a_usage_error_that_names_it(evaluate, arguments, told):
    ended = evaluate(*arguments.split())
    assert ended.exit == USAGE and told in ended.err and ended.out == ""


def test_help_and_version_are_answers(evaluate):
    assert evaluate("--version").out.startswith("calib-eval ")
    for words in ([], ["calibrate"], ["curve"], ["surface"], ["plot"]):
        assert evaluate(*words, "--help").exit == DONE


@pytest.mark.parametrize("bias", [[], ["--depth-bias", "0.3", "--seed", "1"]])
def test_biased_depth_is_found_out_on_recorded_frames(evaluate, kitti_drive, tmp_path, bias):
    disparities = kitti_drive / "depth" / "stereo_net"
    if not disparities.is_dir():
        pytest.skip("the recorded drive has no disparities in depth/stereo_net")
    ended = evaluate("calibrate", "--dataset", "kitti-raw", "--root", kitti_drive, "--depth-dir",
                     disparities, "--depth-kind", "disparity", *bias, "--dof", "6", "--rotation-deg",
                     "1", "--translation-cm", "25", "--starts", "2", "--json", tmp_path / "result.json")
    assert ended.exit == DONE, ended.err
    result = json.loads((tmp_path / "result.json").read_text())
    assert [run["depth_is_biased"] for run in result["runs"]] == [bool(bias)] * 2
    (cell,) = result["cells"]
    assert cell["hits"] == 2 and cell["hit_rotation_error_deg"] < 0.15 and cell["hit_translation_error_cm"] < 10
