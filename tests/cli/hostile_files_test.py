"""No input file may crash a program, block it or exhaust memory: one line says what is wrong."""

import json
import os
import pathlib
import resource
import shutil
import socket
import struct
import subprocess
import threading
import types

import numpy as np
import pytest

from conftest import DONE, FAILED, NO, NOT_FOUND, unwrapped

SECONDS = 60  # much longer than any of this takes


@pytest.fixture(scope="module")
def ended(bin_dir, slowdown):
    """Runs a program with little memory (too little for a sanitizer)."""

    def limit():
        if slowdown == 1:
            resource.setrlimit(resource.RLIMIT_AS, (3 << 30, 3 << 30))

    def run(program, *arguments):
        done = subprocess.run([bin_dir / program, *map(str, arguments)], capture_output=True, text=True, errors="replace",
                              timeout=SECONDS * slowdown, preexec_fn=limit, check=False)
        assert done.returncode >= 0, f"ended by signal {-done.returncode}: {done.stderr}"
        return types.SimpleNamespace(exit=done.returncode, out=done.stdout, err=done.stderr)

    return run


def replace_with_fifo(path):
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def replace_with_link_to_device(path):
    path.unlink(missing_ok=True)
    path.symlink_to("/dev/zero")


NOT_REGULAR = [(replace_with_fifo, "it is a FIFO"), (replace_with_link_to_device, "it is a device")]


# --- calib-eval, calib-replay ---

@pytest.fixture(scope="module")
def made_list(bin_dir, tmp_path_factory):
    folder = tmp_path_factory.mktemp("list")
    done = subprocess.run([bin_dir / "calib-sim", "--dump", folder, "--rate", "0.2", "--camera", "fisheye-double-sphere", "--size",
                           "160x160", "--frames", "3", "--lidar-step-deg", "2"], capture_output=True, text=True, timeout=250,
                          check=True)
    return pathlib.Path(json.loads(done.stdout.splitlines()[-1])["recording"]).parent


@pytest.fixture
def recording(made_list, tmp_path, ended):
    """A copy to be damaged, and the error of calib-eval for it."""
    folder = tmp_path / "list"
    shutil.copytree(made_list, folder)

    def refusal(*options):
        done = ended("calib-eval", "curve", "--dataset", "list", "--root", folder / "recording.yaml",
                     *(options or ("--depth-dir", folder / "depth", "--depth-kind", "range")), "--points", 3, "--dof", 3)
        assert done.exit == FAILED and done.out == "", done.err
        return done.err.splitlines()[-1]

    return types.SimpleNamespace(folder=folder, yaml=folder / "recording.yaml", refusal=refusal,
                                 image=folder / "images/000000.png", cloud=folder / "clouds/000000.bin",
                                 depth=folder / "depth/000000.png")


@pytest.mark.parametrize("spoil, why", NOT_REGULAR)
@pytest.mark.parametrize("what", ["yaml", "image", "cloud"])
def test_a_recording_is_read_from_regular_files_alone(recording, what, spoil, why):
    path = getattr(recording, what)
    spoil(path)
    assert f"{path}: cannot be read: {why}" in recording.refusal()


def test_depth_is_read_from_regular_files_alone(recording):
    replace_with_fifo(recording.depth)
    assert "has no depth of frame 000000" in recording.refusal()


def test_a_symbolic_link_to_a_regular_file_is_one(recording):
    for path in (recording.yaml, recording.image, recording.cloud, recording.depth):
        path.rename(path.with_suffix(".moved"))
        path.symlink_to(path.with_suffix(".moved").name)
    recording.cloud.with_suffix(".moved").write_bytes(b"12345")
    assert f"{recording.cloud} does not hold whole points" in recording.refusal(), "yaml and image were read"


def test_clouds_of_five_floats_are_no_clouds_of_four(recording):
    """Neither hits nor advice about the extrinsic follow from them; the option says what they are."""
    for cloud in recording.cloud.parent.iterdir():
        points = np.fromfile(cloud, np.float32).reshape(-1, 4)
        np.c_[points, np.arange(len(points)) % 32].astype(np.float32).tofile(cloud)
    assert "it looks like 5 floats of 32 bits a point (float32x5), of which number 5 counts rings; say how" in recording.refusal()
    recording.depth.unlink()  # the clouds are read then, and this is what is wrong next
    told = recording.refusal("--depth-dir", recording.folder / "depth", "--depth-kind", "range", "--cloud-layout", "float32x5")
    assert "has no depth of frame 000000" in told


def test_an_npy_with_less_data_than_its_header_says(recording):
    recording.depth.unlink()
    header = b"{'descr': '<f4', 'fortran_order': False, 'shape': (65536, 65536), }"
    npy = recording.depth.with_suffix(".npy")
    npy.write_bytes(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"data")
    assert f"{npy} does not hold as many values as its shape says" in recording.refusal()


@pytest.mark.parametrize("fields, count", [(200_000, 1), (200_000, 4096), (250, 4096)])
def test_a_pcd_with_too_many_fields(recording, fields, count):
    recording.cloud.unlink()
    pcd = recording.cloud.with_suffix(".pcd")
    pcd.write_text(f"FIELDS x y z{' f' * fields}\nSIZE 4 4 4{' 4' * fields}\nTYPE F F F{' F' * fields}\n"
                   f"COUNT 1 1 1{f' {count}' * fields}\nPOINTS 1\nDATA ascii\n1 2 3\n")
    line = recording.refusal()
    assert str(pcd) in line and len(line) < 1000


def test_images_and_clouds_that_are_too_large(recording):
    for path in (recording.cloud, recording.image):
        os.truncate(path, (256 << 20) + 1)
        assert f"{path}: is larger than 256 MiB" in recording.refusal()
    recording.image.write_bytes(b"P5 1000000 1000000 255\n")
    assert f"{recording.image} is 1000000 x 1000000 pixels" in recording.refusal()


def test_deeply_nested_or_recursive_yaml(recording):
    laughs = "a0: &a0 [x, x, x]\n" + "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 40))
    for text in ("[" * 400_000, "{a: " * 400_000, "- " * 400_000, laughs, "&a [*a, *a]", "camera: " + "[" * 100_000):
        recording.yaml.write_text(text)
        assert str(recording.yaml) in recording.refusal()


@pytest.mark.parametrize("spoil, why", NOT_REGULAR)
def test_a_network_is_read_from_regular_files_alone(recording, bin_dir, tmp_path, spoil, why):
    for suffix in (".yaml", ".onnx", ".png", ".f32"):
        shutil.copy(bin_dir.parent / f"tests/depth_models/depth_anything{suffix}", tmp_path)
    for suffix in (".png", ".onnx", ".yaml"):
        spoil(tmp_path / f"depth_anything{suffix}")
        line = recording.refusal("--depth", f"onnx:{tmp_path}/depth_anything.yaml")
        assert f"depth_anything{suffix}: cannot be read: {why}" in line


def test_a_drive_of_kitti_is_read_from_regular_files_alone(ended, tmp_path):
    for name in ("calib_cam_to_cam.txt", "calib_velo_to_cam.txt"):
        replace_with_fifo(tmp_path / name)
    (tmp_path / "drive").mkdir()
    for program, *options in (["calib-replay"], ["calib-eval", "curve", "--depth", "stereo", "--dataset", "kitti-raw", "--root"]):
        done = ended(program, *options, tmp_path / "drive")
        assert done.exit == FAILED and "calib_cam_to_cam.txt: cannot be read: it is a FIFO" in done.err


def test_a_result_is_read_from_regular_files_alone(ended, tmp_path):
    replace_with_fifo(tmp_path / "fifo")
    done = ended("calib-eval", "plot", tmp_path / "fifo", "--out", tmp_path / "out")
    assert done.exit == FAILED and f"{tmp_path}/fifo is no regular file" in done.err
    (tmp_path / "deep").write_text("[" * 100_000)
    assert ended("calib-eval", "plot", tmp_path / "deep", "--out", tmp_path / "out").err.count("\n") == 1

    view = {"view": "start", "score": 1, "histogram": [1, 1, 1, 1], "overlay": "fifo"}
    figure = {"cell": 0, "run": 0, "frame": "0", "features": "depth", "classes": 2, "views": [view]}
    cell = {"objective": "../../../escaped", "dof": 3, "rotation_deg": 1, "translation_cm": 0, "hit_rate": 1, "starts": 1}
    result = {"schema": 1, "kind": "calibrate", "cells": [cell], "runs": [], "figures": [figure]}
    (tmp_path / "r.json").write_text(json.dumps(result))
    (tmp_path / "target").write_text("untouched")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/hits_3dof.png").symlink_to("../target")
    done = ended("calib-eval", "plot", tmp_path / "r.json", "--out", tmp_path / "out")
    assert "1 overlays cannot be read" in done.err
    assert (tmp_path / "target").read_text() == "untouched" and not (tmp_path / "out/hits_3dof.png").is_symlink()
    assert len(list((tmp_path / "out").iterdir())) == len(done.out.splitlines()) == 2, "all pictures are in the folder"


# --- the configuration ---

def test_a_configuration_is_a_regular_file_of_bounded_size(ended, tmp_path):
    file = tmp_path / "c.yaml"
    for program, *options in (["calibctl", "check-config"], ["calibd", "--check-config", "--config"]):
        for spoil, why in NOT_REGULAR:
            spoil(file)
            done = ended(program, *options, file)
            assert done.exit not in (DONE, None) and f"{file}: cannot be read: {why}" in done.err
        file.unlink()
        for text, why in (("#" * ((1 << 20) + 1), "is larger than 1 MiB"), ("[" * 400_000, "not YAML"), ("- " * 400_000, ":1: ")):
            file.write_text(text)
            done = ended(program, *options, file)
            assert done.exit not in (DONE, None) and f"{file}:1: " in done.err and why in done.err


# --- calibctl ---

@pytest.fixture
def exported(calibctl, tmp_path):
    out = tmp_path / "out"
    assert calibctl("show", "1", "--export", out).exit == DONE
    return out / "000001.json"


@pytest.mark.parametrize("spoil, why", NOT_REGULAR)
def test_records_and_keys_are_read_from_regular_files_alone(calibctl, exported, ended, spoil, why):
    for path in (exported.with_name(exported.name + ".minisig"), exported):
        spoil(path)
        done = ended(*calibctl.command("verify", exported))
        assert done.exit == NOT_FOUND and done.out == "" and f"{path}: cannot be read: {why}" in done.err
    spoil(calibctl.public_key)
    done = ended(*calibctl.command("verify"))
    assert done.exit == FAILED and "is not a minisign key file" in done.err


@pytest.mark.parametrize("spoil, why", NOT_REGULAR)
def test_a_store_is_read_from_regular_files_alone(calibctl, ended, spoil, why):
    for suffix in ("-wal", "-shm", "-journal", ""):
        path = calibctl.store.with_name(calibctl.store.name + suffix)
        spoil(path)
        for command in ("verify", "history", "show"):
            done = ended(*calibctl.command(command))
            assert done.exit == FAILED and done.out == "" and f"{path} is no regular file" in done.err
        assert f"{path} is no regular file" in unwrapped(ended(*calibctl.command("status", "front")).out)
        path.unlink()


def test_a_record_that_is_too_large_does_not_verify(calibctl, exported):
    os.truncate(exported, (2 << 20) + 1)
    verified = calibctl("verify", exported)
    assert verified.exit == NO and f"{exported}: is larger than 2 MiB" in verified.err


def test_a_snapshot_is_a_regular_file_of_bounded_size_and_depth(calibctl, ended):
    snapshot = json.loads(calibctl.snapshot.read_text())

    def told(text=None):
        if text is not None:
            calibctl.snapshot.write_text(text)
        done = [ended(*calibctl.command("status", *json_option)) for json_option in ([], ["--json"])]
        assert {each.exit for each in done} <= {FAILED, NOT_FOUND, NO}
        return done[0].err

    for depth in (100, 1_000_000):
        assert "not a status" in told(calibctl.snapshot.read_text()[:-2] + ', "deep": ' + "[" * depth + "]" * depth + "}")
        calibctl.snapshot.write_text(json.dumps(snapshot))
    assert "not a status" in told("[" * 1_000_000)
    assert "is larger than 4 MiB" in told(" " * ((4 << 20) + 1))
    for spoil, why in NOT_REGULAR:
        spoil(calibctl.snapshot)
        assert why in told()


def test_a_snapshot_with_dates_centuries_away_is_shown(calibctl):
    snapshot = json.loads(calibctl.snapshot.read_text())
    for year in ("1678", "2261"):
        snapshot["pairs"][0]["since"] = f"{year}-01-01T00:00:00Z"
        snapshot["pairs"][0]["inputs"]["image"]["age_s"] = 1e308
        calibctl.snapshot.write_text(json.dumps(snapshot))
        shown = calibctl("status", "front")
        assert shown.exit == NOT_FOUND and f"{year}-01-01" in shown.out
        assert calibctl("status").exit == NOT_FOUND


@pytest.fixture
def answered(calibctl):
    """Runs calibctl with a calibd that answers with these bytes."""

    def ask(answer, *arguments):
        with socket.socket(socket.AF_UNIX) as listener:
            listener.bind(str(calibctl.socket))
            listener.listen()

            def serve():
                connection, _ = listener.accept()
                with connection:
                    connection.recv(65536)
                    connection.sendall(answer + b"\n")

            server = threading.Thread(target=serve)
            server.start()
            done = calibctl(*arguments)
            server.join()
        calibctl.socket.unlink()
        return done

    return ask


def test_a_deeply_nested_answer_is_malformed(answered):
    done = answered(b'{"ok": true, "status": ' + b"[" * 1_000_000, "status", "--json")
    assert done.exit == FAILED and "the answer is not an object" in done.err
    deep = b"[" * 100_000 + b"]" * 100_000
    done = answered(b'{"ok": true, "checks": [], "overlays": [], "more": ' + deep + b"}", "doctor", "--json")
    assert done.exit == FAILED and "the answer is not an object" in done.err


def test_only_pictures_are_copied_and_never_through_a_link(answered, tmp_path):
    pictures, secret, picture = tmp_path / "pictures", tmp_path / "secret.png", tmp_path / "picture.png"
    secret.write_text("a secret of root")
    picture.write_bytes(b"\x89PNG\r\n\x1a\npixels")

    def ask(file):
        answer = {"ok": True, "checks": [{"pair": "front", "check": "agreement", "result": "ok", "seen": "all is well"}],
                  "overlays": [{"pair": "front", "file": str(file)}]}
        return answered(json.dumps(answer).encode(), "doctor", "--overlay", pictures)

    done = ask(secret)
    assert done.exit == FAILED and f"{secret} cannot be copied" in done.err and "it is not a picture" in done.err
    replace_with_fifo(tmp_path / "fifo.png")
    assert "it is a FIFO" in ask(tmp_path / "fifo.png").err
    assert not list(pictures.iterdir())
    (pictures / "picture.png").symlink_to(secret)
    assert ask(picture).exit == DONE
    assert secret.read_text() == "a secret of root" and (pictures / "picture.png").read_bytes() == picture.read_bytes()
