"""wait: a state counts as reached only when a running calibd says so."""

import copy
import json
import subprocess
import threading
import time

import pytest

from conftest import DONE, FAILED, NOT_FOUND, USAGE

TIMED_OUT = 5


@pytest.fixture
def status(calibctl):
    return json.loads(calibctl.snapshot.read_text())


def with_verdicts(status, **verdicts):
    changed = copy.deepcopy(status)
    front = changed["pairs"][0]
    changed["pairs"] = [{**front, "name": name, "verdict": verdict, "record": front["record"] if name == "front" else None}
                        for name, verdict in verdicts.items()]
    return {"ok": True, "status": changed}


@pytest.mark.parametrize("verdicts, reached", [
    ({"front": "calibrated", "rear": "calibrated"}, {"calibrated"}),
    ({"front": "calibrated", "rear": "suspect"}, set()),
    ({"front": "calibrated", "rear": "drifted"}, {"drifted"}),
    ({"front": "drifted", "rear": "not_evaluated"}, {"drifted", "not_evaluated"}), ({}, set())])
def test_calibrated_means_all_pairs_and_the_others_one(calibctl, peer, status, schema, verdicts, reached):
    peer(with_verdicts(status, **verdicts))
    for state in ("calibrated", "drifted", "not_evaluated", "any-change"):
        ended = calibctl("wait", "--for", state, "--timeout", "0s")
        assert ended.exit == (DONE if state in reached else TIMED_OUT), state
        assert (ended.err == "") == (state in reached) == (ended.out != "")
        as_json = calibctl("wait", "--for", state, "--timeout", "0s", "--json")
        result = json.loads(as_json.out)
        schema("wait", result)
        assert as_json.exit == ended.exit
        assert result["for"] == state and result["reached"] is (state in reached)
        assert {pair["name"]: pair["verdict"] for pair in result["pairs"]} == verdicts


def test_one_pair_can_be_waited_for(calibctl, peer, status):
    peer(with_verdicts(status, front="calibrated", rear="drifted"))
    assert calibctl("wait", "front", "--for", "calibrated").out.startswith("front is calibrated, after 0.")
    assert calibctl("wait", "--for", "calibrated", "rear", "--timeout", "100ms").exit == TIMED_OUT
    unknown = calibctl("wait", "--for", "calibrated", "roof")
    assert unknown.exit == NOT_FOUND and "there is no pair 'roof'" in unknown.err


def test_a_snapshot_reaches_nothing(calibctl):
    assert calibctl("status").out.count("calibrated") == 1, "the snapshot says so"
    started = time.monotonic()
    ended = calibctl("wait", "--for", "calibrated", "--timeout", "1200ms")
    assert ended.exit == TIMED_OUT and ended.out == "" and "calibd does not run" in ended.err
    assert 1.2 <= time.monotonic() - started < 10


def test_a_daemon_that_starts_meanwhile_is_heard(calibctl, peer, status):
    late = threading.Timer(1.0, lambda: peer(with_verdicts(status, front="calibrated")))
    late.start()
    ended = calibctl("wait", "--for", "calibrated", "--timeout", "30s")
    late.join()
    assert ended.exit == DONE and ended.out.startswith("front is calibrated, after ")


def test_a_change_is_one_of_the_verdict_or_of_its_time(calibctl, peer, status):
    for change in ({"verdict": "suspect"}, {"since": "2026-02-01T00:00:00Z"}, None):
        listening = peer(with_verdicts(status, front="calibrated"))
        with subprocess.Popen(calibctl.command("wait", "--for", "any-change", "--timeout", "30s" if change else "1.5s"),
                              stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
            while len(listening.questions) < 2:
                assert running.poll() is None
                time.sleep(0.01)
            changed = with_verdicts(status, front="calibrated")
            changed["status"]["pairs"][0].update(change or {"evaluated": 4242})
            listening.reply = json.dumps(changed).encode() + b"\n"
            assert running.wait(timeout=20) == (DONE if change else TIMED_OUT)
        listening.close()
        calibctl.socket.unlink()


def test_a_verdict_that_has_expired_reaches_nothing(calibctl, peer, status):
    status["pairs"][0]["evidence"]["since_boot_s"] -= 4000
    peer(with_verdicts(status, front="calibrated"))
    ended = calibctl("wait", "--for", "calibrated", "--timeout", "0s")
    assert ended.exit == TIMED_OUT and "front is not evaluated" in ended.err
    assert calibctl("wait", "--for", "not_evaluated", "--timeout", "0s").exit == DONE


def test_a_record_that_does_not_verify_is_not_calibrated(calibctl, peer, status):
    status["pairs"][0]["record"]["sequence"] = 2
    peer(with_verdicts(status, front="calibrated"))
    ended = calibctl("wait", "--for", "calibrated", "--timeout", "0s")
    assert ended.exit == TIMED_OUT and "its record does not verify" in ended.err


def test_what_waiting_does_not_mend_ends_it(calibctl, peer):
    peer({"ok": False, "code": "denied", "message": "no"})
    ended = calibctl("wait", "--for", "calibrated")
    assert ended.exit == FAILED and ended.err == "calibctl: no\n"


@pytest.mark.parametrize("arguments", [[], ["--for", "happy"], ["--for", "calibrated", "--timeout", "soon"],
                                       ["--for", "calibrated", "--timeout", "-1s"],
                                       ["--for", "calibrated", "--timeout", "60 parsecs"],
                                       ["--for", "calibrated", "--timeout", "nan"],
                                       ["--for", "calibrated", "--timeout", "1e300h"]])
def test_wrong_usage(calibctl, arguments):
    ended = calibctl("wait", *arguments)
    assert ended.exit == USAGE and ended.out == "" and ended.err != ""
