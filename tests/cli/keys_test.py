"""Changes of the signing key, comments, and a key that is not the records': calibctl with the real calibd."""

import json
import os
import pathlib
import re
import shutil
import signal
import socket
import subprocess
import time

import pytest

from conftest import DONE, FAILED, NO, NOT_FOUND, USAGE
from daemon_test import configuration, wait_for_status  # noqa: F401: a fixture

HEAD_FOLDER = "-head"


class Vehicle:
    """calibd on one state folder, started and stopped."""

    def __init__(self, calibctl, bin_dir, configuration):
        self.calibctl, self.folder, self.running = calibctl, calibctl.folder, None
        self.command = [bin_dir / "calibd", "--config", configuration]
        for name in ("next", "third"):
            assert calibctl("keygen", "--out", self.folder / f"{name}.key").exit == DONE

    def start(self):
        self.running = subprocess.Popen(self.command, stderr=open(self.folder / "log", "wb"))
        wait_for_status(self.calibctl, self.running)

    def stop(self, how=signal.SIGTERM):
        self.running.send_signal(how)
        self.running.wait(20)

    def log(self):
        return (self.folder / "log").read_text()

    def put_in_place(self, name):
        shutil.copy(self.folder / f"{name}.key", self.calibctl.key)

    def key_id(self, name):
        return (self.folder / f"{name}.pub").read_text().split("\n")[0].split()[-1]

    def status(self):
        return json.loads(self.calibctl("status", "--json").out)

    def verify_with(self, name):
        before, self.calibctl.public_key = self.calibctl.public_key, self.folder / f"{name}.pub"
        verified = self.calibctl("verify")
        self.calibctl.public_key = before
        return verified


@pytest.fixture
def vehicle(bare, bin_dir, configuration):  # noqa: F811
    made = Vehicle(bare, bin_dir, configuration)
    made.start()
    yield made
    made.running.kill()
    made.running.wait()


def test_a_key_is_rotated_by_a_record_of_both_keys(vehicle, schema, tmp_path):
    done = vehicle.calibctl("rotate-key", vehicle.folder / "next.key", "--comment", "yearly change")
    assert done.exit == DONE, done.err
    assert f"key {vehicle.key_id('next')} replaces key {vehicle.key_id('signing')}" in done.out and "mv " in done.out
    record = json.loads(vehicle.calibctl("show", "2", "--json").out)
    schema("record", record)
    assert record["decision"] == "key_changed" and record["comment"] == "yearly change"
    assert record["asked_by"] == f"uid:{os.geteuid()}" and "pair" not in record
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE
    out = tmp_path / "out"
    assert vehicle.calibctl("export", "--all", "--to", out).exit == DONE
    for name in ("signing", "next"):
        verified = vehicle.verify_with(name)
        assert verified.exit == DONE, verified.err
        assert f"keys {vehicle.key_id('signing')} (records 1 to 2), {vehicle.key_id('next')} (record 3)" in verified.out
    assert vehicle.verify_with("third").exit == NO
    assert vehicle.calibctl("verify", *out.iterdir()).exit == DONE
    assert vehicle.calibctl("verify", out / "000003.json").exit == NO, "nothing leads to its key"
    assert vehicle.calibctl("verify", out / "000003.json", out / "000002.json").exit == DONE
    # As two signature files of one text, which minisign checks one by one.
    both = (out / "000002.json.minisig").read_text().splitlines(keepends=True)
    assert len(both) == 8
    (out / "next.minisig").write_text("".join(both[4:]))
    for signature, key in (("000002.json.minisig", "signing"), ("next.minisig", "next")):
        subprocess.run(["minisign", "-Vm", out / "000002.json", "-x", out / signature, "-p", vehicle.folder / f"{key}.pub"],
                       check=True, capture_output=True)
    vehicle.stop()
    vehicle.put_in_place("next")
    vehicle.start()
    status = vehicle.status()
    schema("status", status)
    assert status["records"] == {"missing": None, "signing_refused": None}
    assert status["pairs"][0]["record"]["key_id"] == vehicle.key_id("next")
    assert "set aside" not in vehicle.log()
    shown = vehicle.calibctl("history")
    assert shown.exit == DONE and '"yearly change"' in shown.out and all(len(line) <= 100 for line in shown.out.splitlines())


def test_a_key_that_is_not_the_records_does_not_stop_the_watching(vehicle, schema):
    assert vehicle.calibctl("rotate-key", vehicle.folder / "next.key").exit == DONE
    vehicle.stop()
    vehicle.start()  # still with the key before
    status = vehicle.status()
    schema("status", status)
    why = status["records"]["signing_refused"]
    assert f"key {vehicle.key_id('signing')} is not the chain's key {vehicle.key_id('next')}" in why and "restart calibd" in why
    shown = vehicle.calibctl("status")
    assert shown.exit == DONE and "SIGNING" in shown.out and "REFUSED: key" in shown.out
    assert vehicle.calibctl("status", "--exit-code").exit == NO
    waited = vehicle.calibctl("wait", "--for", "calibrated", "--timeout", "0s")
    assert waited.exit == 5 and "signing is refused" in waited.err
    log = vehicle.log()
    assert log.count("signing is refused") == 1 and "calibd watches" in log
    for refused in (["rollback", "front", "--to", "1"], ["accept", "front"], ["recalibrate", "front"],
                    ["rotate-key", vehicle.folder / "third.key"]):
        answer = vehicle.calibctl(*refused)
        assert answer.exit == NO and "is not the chain's key" in answer.err, answer
    assert "pairs" in vehicle.calibctl("recalibrate", "front", "--dry-run").err  # which needs no record
    assert vehicle.calibctl("verify").out.startswith("2 records verified")
    before = status["pairs"][0]["skipped"]
    deadline = time.monotonic() + 20
    while vehicle.status()["pairs"][0]["skipped"] == before:
        assert time.monotonic() < deadline, "it does not watch"
        time.sleep(0.2)
    vehicle.stop()
    vehicle.put_in_place("next")
    vehicle.start()
    assert vehicle.status()["records"]["signing_refused"] is None
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE


def test_a_lost_key_is_replaced_and_its_records_are_doubted(vehicle):
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE
    nothing = vehicle.calibctl("rotate-key", "--lost", "--json")
    assert nothing.exit == USAGE and "nothing is lost" in nothing.err
    vehicle.stop()
    vehicle.put_in_place("next")
    vehicle.start()
    assert "rotate-key --lost" in vehicle.status()["records"]["signing_refused"]
    done = vehicle.calibctl("rotate-key", "--lost", "--doubt-from", "2", "--json")
    assert done.exit == DONE and json.loads(done.out)["answer"] == "key_changed", done.err
    assert "which is lost" in json.loads(done.out)["reason"]
    assert vehicle.status()["records"]["signing_refused"] is None
    by_lost = vehicle.calibctl("verify")
    assert by_lost.exit == NO and f"key {vehicle.key_id('signing')} was lost" in by_lost.err
    verified = vehicle.verify_with("next")
    assert verified.exit == DONE and "REVOKED: record 2 may be of somebody else" in verified.out, verified
    vehicle.stop()
    vehicle.start()
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE


def test_an_unknown_key_watches_what_the_configuration_says_and_writes_nothing(vehicle):
    vehicle.stop()
    for name in ("signing.key", "signing.pub"):
        (vehicle.folder / name).rename(vehicle.folder / ("old-" + name))
    assert vehicle.calibctl("keygen", "--out", vehicle.calibctl.key).exit == DONE
    vehicle.start()
    status = vehicle.status()
    assert "do not verify with key" in status["records"]["signing_refused"]
    assert status["pairs"][0]["record"] is None and status["pairs"][0]["verdict"] == "not_evaluated"
    assert vehicle.calibctl("status", "--exit-code").exit == NO
    vehicle.stop()
    (vehicle.folder / "old-signing.key").rename(vehicle.calibctl.key)
    (vehicle.folder / "old-signing.pub").rename(vehicle.calibctl.public_key)
    vehicle.start()
    assert vehicle.status()["records"] == {"missing": None, "signing_refused": None}
    assert vehicle.calibctl("verify").out.startswith("1 record verified")


@pytest.mark.parametrize("arguments, exit_code, words", [
    (["rotate-key"], USAGE, "--lost"), (["rotate-key", "a.key", "--lost"], USAGE, "lost"),
    (["rotate-key", "/no/such/file"], NOT_FOUND, "/no/such/file"), (["rotate-key", "/etc/passwd"], FAILED, "/etc/passwd"),
    (["rotate-key", "{next}", "--doubt-from", "9"], USAGE, "signed records 1 to 1"),
    (["rotate-key", "{next}", "--comment", "two\nlines"], USAGE, "control characters"),
    (["rotate-key", "{signing}"], USAGE, "does not come back")])
def test_an_impossible_change_of_keys_is_refused_with_a_reason(vehicle, arguments, exit_code, words):
    names = {"next": vehicle.folder / "next.key", "signing": vehicle.calibctl.key}
    refused = vehicle.calibctl(*(str(each).format(**names) for each in arguments))
    assert refused.exit == exit_code and refused.out == "" and words in refused.err, refused
    assert vehicle.calibctl("verify").out.startswith("1 record verified")


def test_a_comment_is_in_the_signed_record_with_who_made_it(vehicle, schema):
    comment = 'bracket replaced, "left" \\ ä'
    done = vehicle.calibctl("rollback", "front", "--to", "1", "--comment", comment)
    assert done.exit == DONE, done.err
    record = json.loads(vehicle.calibctl("show", "--json").out)
    schema("record", record)
    login = int(pathlib.Path("/proc/self/loginuid").read_text())
    assert record["schema"] == 3 and record["comment"] == comment and record["asked_by"] == f"uid:{os.geteuid()}"
    assert record["login"] == (f"uid:{login}" if login != 2**32 - 1 else None)
    assert comment in vehicle.calibctl("history").out and f"Comment         : {comment}" in vehicle.calibctl("show").out
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE
    plain = json.loads(vehicle.calibctl("show", "--json").out)
    schema("record", plain)
    assert plain["schema"] == 2 and "comment" not in plain and "login" not in plain
    for bad in ("a\nb", "\x1b[31m", "x" * 1001, b"\xff"):
        refused = vehicle.calibctl("rollback", "front", "--to", "1", "--comment", bad)
        assert refused.exit == USAGE and refused.out == "", refused
        # Nor from a client that checks nothing.
        if isinstance(bad, str):
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(str(vehicle.calibctl.socket))
                client.sendall(json.dumps({"schema": 1, "request": "rollback", "pair": "front", "to": 1,
                                           "comment": bad}).encode() + b"\n")
                assert json.loads(client.makefile().readline())["code"] == "bad_request"
    assert vehicle.calibctl("verify").out.startswith("3 records verified")


def test_files_that_come_with_a_request_are_read_for_a_key_only_and_closed(vehicle):
    descriptors = pathlib.Path(f"/proc/{vehicle.running.pid}/fd")
    before = len(list(descriptors.iterdir()))
    for request in ({"request": "status"}, {"request": "rotate_key"}, {"request": "nonsense"}):
        for _ in range(20):
            with socket.socket(socket.AF_UNIX) as client, open("/dev/zero", "rb") as file:
                client.connect(str(vehicle.calibctl.socket))
                socket.send_fds(client, [json.dumps({"schema": 1, **request}).encode() + b"\n"], [file.fileno()] * 3)
                reply = json.loads(client.makefile().readline())
                assert reply["ok"] == (request["request"] == "status")
                assert reply["ok"] or reply["code"] == "bad_request"
    deadline = time.monotonic() + 10
    while len(list(descriptors.iterdir())) > before + 2:
        assert time.monotonic() < deadline
        time.sleep(0.1)


@pytest.mark.skipif(os.geteuid() != 0, reason="reads another process' memory")
def test_the_secret_key_is_nowhere_in_memory_but_in_locked_pages_that_no_core_file_has(vehicle, slowdown):
    if slowdown > 1:
        pytest.skip("a sanitizer keeps what was freed")
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE
    assert vehicle.calibctl("rotate-key", vehicle.folder / "next.key").exit == DONE
    assert vehicle.calibctl("rollback", "front", "--to", "1").exit == DONE
    found = {name: [] for name in ("signing", "next")}
    import base64
    seeds = {}
    for name in found:
        text = (vehicle.folder / f"{name}.key").read_text().splitlines()[1]
        # The seed, and its base64 as the file has it, from a boundary of three bytes on.
        seeds[name] = base64.b64decode(text)[62:94], text[84:124].encode()
    mappings = re.split(r"(?m)^(?=[0-9a-f]+-[0-9a-f]+ )", pathlib.Path(f"/proc/{vehicle.running.pid}/smaps").read_text())
    with open(f"/proc/{vehicle.running.pid}/mem", "rb", buffering=0) as memory:
        for mapping in filter(None, mappings):
            begin, end = (int(word, 16) for word in mapping.split()[0].split("-"))
            if not mapping.split()[1].startswith("r") or "[v" in mapping.splitlines()[0]:
                continue
            memory.seek(begin)
            try:
                content = memory.read(end - begin)
            except OSError:
                continue
            flags = re.search(r"VmFlags: (.*)", mapping)[1].split()
            for name, seed in seeds.items():
                found[name] += [flags for each in seed if each in content]
    assert found["signing"] == [], "the key before is wiped"
    assert len(found["next"]) == 1 and {"lo", "dd"} <= set(found["next"][0])
