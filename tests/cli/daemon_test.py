"""calibctl with the real calibd, which no sensor feeds: what it answers, and what it leaves."""

import json
import os
import pathlib
import re
import shutil
import signal
import socket
import sqlite3
import subprocess
import tempfile
import time

import pytest

from conftest import DONE, FAILED, NO, NOT_FOUND, Calibctl
from support.frozen import Frozen, thread_of

CONFIGURATION = """
vehicle: demo-car
state_dir: {folder}
runtime_dir: {folder}
signing_key: {folder}/signing.key
dds: {{domain: {domain}, interface: lo}}
sampling: {{period: 500ms, window: 200ms, max_time_difference: 50ms}}
pairs:
  - name: front
    camera: {{image: /camera/left/image, model: rectified, size: [1242, 375],
             intrinsics: [721.5377, 721.5377, 609.5593, 172.854]}}
    lidar: {{cloud: /lidar/points}}
    T_camera_lidar: {{translation_m: [0.25, -0.08, 0.5], quaternion_xyzw: [0.5, -0.5, 0.5, -0.5]}}
    depth: {{source: stereo, right_image: /camera/right/image, baseline_m: 0.5327}}
    recalibration: {{mode: apply, frames: 25, max_rotation_deg: 5, max_translation_cm: 50}}
"""


@pytest.fixture
def configuration(bare, dds_domain):
    bare("keygen", "--out", bare.key)
    file = bare.folder / "calibd.yaml"
    file.write_text(CONFIGURATION.format(folder=bare.folder, domain=dds_domain))
    return file


def wait_for_status(bare, running):
    deadline = time.monotonic() + 30
    while bare("status").exit != DONE:
        assert running.poll() is None and time.monotonic() < deadline, f"calibd ended with {running.poll()} or is silent"
        time.sleep(0.1)


@pytest.fixture
def daemon(bare, bin_dir, configuration):
    """A running calibd that answers."""
    with open(bare.folder / "log", "wb") as log:
        running = subprocess.Popen([bin_dir / "calibd", "--config", configuration], stderr=log, stdout=log)
    try:
        wait_for_status(bare, running)
        yield running
    finally:
        running.kill()
        running.wait()


def test_status_of_a_pair_without_data_is_not_evaluated_and_its_record_verifies(bare, daemon, schema):
    shown = bare("status", "--json")
    assert shown.exit == DONE
    status = json.loads(shown.out)
    schema("status", status)
    pair, = status["pairs"]
    assert status["daemon"]["running"] is True and status["vehicle"] == "demo-car"
    assert pair["verdict"] == "not_evaluated" and pair["reason"] != "" and pair["evaluated"] == 0
    assert pair["record"]["verified"] is True and pair["record"]["verified_by"] == "calibctl"
    assert bare("status", "--exit-code").exit == NO
    assert bare("verify").exit == DONE
    record = json.loads(bare("show", "--json").out)
    schema("record", record)
    assert record["decision"] == "initial" and record["asked_by"] == "configuration"


@pytest.mark.parametrize("arguments, exit_code, words", [
    (["recalibrate", "front"], FAILED, "pairs"), (["recalibrate", "front", "--dry-run"], FAILED, "pairs"),
    (["recalibrate", "rear"], NOT_FOUND, "rear"), (["accept", "front"], NOT_FOUND, "propos"),
    (["rollback", "front"], NOT_FOUND, "earlier"), (["rollback", "front", "--to", "9"], NOT_FOUND, "9")])
def test_an_impossible_request_is_refused_with_a_reason(bare, daemon, arguments, exit_code, words):
    refused = bare(*arguments)
    assert refused.exit == exit_code and refused.out == "" and words in refused.err


def test_a_rollback_is_recorded_with_the_user_who_requested_it(bare, daemon, schema):
    done = bare("rollback", "front", "--to", "1")
    assert done.exit == DONE and "rolled back" in done.out
    record = json.loads(bare("show", "--json").out)
    schema("record", record)
    assert record["decision"] == "rolled_back" and record["asked_by"].startswith("uid:") and record["sequence"] == 2
    assert json.loads(bare("status", "--json").out)["pairs"][0]["record"]["sequence"] == 2


def test_requests_of_closed_connections_are_dropped(bare, daemon):
    question = json.dumps({"schema": 1, "request": "rollback", "pair": "front", "to": 1}).encode() + b"\n"
    with Frozen(thread_of(daemon.pid, "pairs")):
        for _ in range(60):
            with socket.socket(socket.AF_UNIX) as asker:
                asker.connect(str(bare.socket))
                asker.sendall(question)
                asker.settimeout(0.05)
                try:
                    asker.recv(1)
                except TimeoutError:
                    pass
    last = bare("rollback", "front", "--to", "1")
    assert last.exit == DONE
    # A row each below the header, and its reason indented.
    records = len([line for line in bare("history").out.splitlines()[1:] if not line.startswith(" ")])
    assert 2 <= records <= 1 + 16 + 1


@pytest.mark.skipif(os.geteuid() != 0, reason="needs another user")
def test_a_user_who_may_not_read_the_store_gets_the_records_from_the_daemon(bin_dir, dds_domain):
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        folder.chmod(0o755)
        other = Calibctl(bin_dir, folder)
        other("keygen", "--out", other.key)
        (folder / "calibd.yaml").write_text(CONFIGURATION.format(folder=folder, domain=dds_domain))
        # Of calibd's group, and not calibd's user.
        member = {"user": 65534, "group": os.getegid(), "extra_groups": []}
        with subprocess.Popen([bin_dir / "calibd", "--config", folder / "calibd.yaml"], stderr=subprocess.DEVNULL) as running:
            try:
                deadline = time.monotonic() + 30
                while other("status", **member).exit != DONE:
                    assert running.poll() is None and time.monotonic() < deadline
                    time.sleep(0.1)
                for _ in range(3):
                    assert other("rollback", "front", "--to", "1").exit == DONE
                verified = other("verify", **member)
                assert verified.exit == DONE and verified.out.startswith("4 records verified"), verified
                assert other("history", **member).out == other("history").out != ""
                status = json.loads(other("status", "--json", **member).out)
                assert status["pairs"][0]["record"]["verified_by"] == "calibd"
            finally:
                running.terminate()
        denied = other("verify", **member)
        assert denied.exit == NOT_FOUND and "only calibd and root may read" in denied.err
        assert other("verify").exit == DONE


def test_a_truncated_chain_does_not_verify(bare, daemon):
    assert bare("rollback", "front", "--to", "1").exit == DONE
    daemon.send_signal(signal.SIGKILL)
    daemon.wait()
    assert bare("verify").exit == DONE
    with sqlite3.connect(bare.store) as store:
        store.execute("delete from record where sequence = 2")
    cut = bare("verify")
    assert cut.exit == NO and "records were deleted" in cut.err


def test_a_killed_daemon_leaves_its_snapshot(bare, daemon, schema):
    daemon.send_signal(signal.SIGKILL)
    daemon.wait()
    shown = bare("status", "--json")
    assert shown.exit == NOT_FOUND
    status = json.loads(shown.out)
    schema("status", status)
    assert status["daemon"]["running"] is False
    assert status["pairs"][0]["record"]["verified_by"] == "calibctl" and status["pairs"][0]["record"]["verified"]
    assert bare("accept", "front").exit == NOT_FOUND


def test_the_shipped_configuration_is_refused_until_it_names_a_vehicle_and_is_valid_then(bare, source_dir, tmp_path):
    bare_shell = {"PATH": "/usr/bin:/bin"}
    shipped = source_dir / "systemd" / "calibd.yaml"
    refused = bare("check-config", shipped, env=bare_shell)
    assert refused.exit == FAILED and re.fullmatch(r".*/calibd\.yaml: these are still the example's values; .*\n", refused.err)
    (tmp_path / "own.yaml").write_text(shipped.read_text().replace("demo-car", "van-7"))
    assert bare("check-config", tmp_path / "own.yaml", env=bare_shell).exit == DONE


def test_check_config_without_a_calibd_is_not_found(bare, tmp_path, configuration):
    alone = tmp_path / "alone"
    alone.mkdir()
    bare.program = shutil.copy(bare.program, alone)
    missing = bare("check-config", configuration, env={"PATH": str(alone)})
    assert missing.exit == NOT_FOUND and "no calibd" in missing.err


def test_check_config_reports_what_calibd_reports(bare, configuration):
    assert bare("check-config", configuration).exit == DONE
    configuration.write_text(configuration.read_text().replace("vehicle:", "vehikel:"))
    wrong = bare("check-config", configuration)
    assert wrong.exit == FAILED and "vehikel" in wrong.err and len(wrong.err.splitlines()) == 1
    assert bare("check-config", bare.folder / "no such file").exit == FAILED


def test_onnx_runtime_is_needed_only_by_who_uses_a_network(bare, bin_dir, source_dir, configuration, slowdown):
    """Without the library, calibd runs with stereo depth, and says what a network needs."""
    if slowdown > 1:
        pytest.skip("with sanitizers it is linked")
    if not list(bin_dir.parent.glob("lib/*/calibd/libonnxruntime.so.1")):
        pytest.skip("ONNX Runtime is the system's own here and cannot be taken away, or calibd is built without")
    root = bare.folder / "root"
    shutil.copytree(bin_dir.parent / "lib", root / "lib")
    (root / "bin").mkdir()
    shutil.copy(bin_dir / "calibd", root / "bin")
    for library in root.glob("lib/*/calibd/libonnxruntime*"):
        library.unlink()
    calibd = [root / "bin/calibd", "--config", configuration]
    with subprocess.Popen(calibd, stderr=subprocess.PIPE, text=True) as running:
        wait_for_status(bare, running)
        running.terminate()
        assert running.wait(10) == 0, running.stderr.read()

    text = configuration.read_text()
    network = f"depth: {{source: onnx, model: {source_dir}/libcalib/models/street-small.yaml}}"
    configuration.write_text(re.sub("depth: {source: stereo.*}", network, text))
    refused = subprocess.run(calibd, capture_output=True, text=True, timeout=30, check=False)
    assert refused.returncode == 78, refused.stderr
    said = (r"depth from a network needs the package calibd-onnx: libonnxruntime.so.1 cannot be used: .*; install it "
            r"\(ONNX Runtime 1\.\d+ or newer\), or use another depth source")
    assert re.search(said, refused.stderr), refused.stderr
    checked = subprocess.run([*calibd, "--check-config"], capture_output=True, text=True, timeout=30, check=False)
    assert checked.returncode == 78 and checked.stderr.count("\n") == 1 and re.search(said, checked.stderr), checked.stderr
