"""status without a daemon, and calibctl against a peer that does not keep to proto/control.md."""

import json
import os
import sqlite3
import time

import pytest

from conftest import DONE, FAILED, NO, NOT_FOUND, USAGE, row_of, write_store


def test_the_snapshot_of_a_daemon_that_does_not_run_is_shown_as_such(calibctl, schema):
    os.utime(calibctl.snapshot, (time.time() - 90, time.time() - 90))
    shown = calibctl("status", "--json")
    assert shown.exit == NOT_FOUND
    status = json.loads(shown.out)
    schema("status", status)
    assert status["daemon"]["running"] is False
    assert 89 < status["daemon"]["snapshot_age_s"] < 150
    record = status["pairs"][0]["record"]
    assert record["verified"] is True and record["verified_by"] == "calibctl" and record["sequence"] == 3
    text = calibctl("status")
    assert text.exit == NOT_FOUND
    assert "NOT RUNNING; this is its last snapshot, 9" in text.out


def test_status_has_words_for_signs_and_aligned_colons(calibctl):
    out = calibctl("status", "front").out
    for words in ("Verdict         : calibrated\n", "Roll            : 0.10 degrees right side down, sigma 0.06; detection limit 0.11",
                  "Pitch           : 0.20 degrees nose up", "Yaw             : 0.60 degrees to the left",
                  "X               : not observable\n", "Y               : 2.0 cm to the left, sigma 0.1; detection limit 0.2\n",
                  "Z               : 0.0 cm, sigma",
                  "Skipped         : 4 (dark 1, low_overlap 3)", "Image           : /camera/left/image, 0.2 s ago",
                  "Cloud           : /lidar/points, never seen", "12.5 ms, cloud before image", "verified"):
        assert words in out
    assert all(line[16:18] == ": " for line in out.splitlines() if line)


def test_status_lines_are_short_and_each_detail_has_a_line_of_its_own(calibctl, peer):
    status = json.loads(calibctl.snapshot.read_text())
    pair = status["pairs"][0]
    pair["evidence"], pair["verdict"] = None, "not_evaluated"
    pair["reason"] = "sensor_silent: no image arrived; " + "a detail of many words " * 10 + "; \x1b[31mthe last one"
    pair["skipped"] = {f"malformed:reason_{number}": 10**6 for number in range(20)}
    pair["remarks"] = {"malformed:row_step": {"count": 7, "text": "/points: row_step is \x1b[31m0, " + "and so on " * 20}}
    pair["inputs"]["image"]["topic"] = "/" + "a" * 200
    status["records"]["missing"] = "records that calibd had written are missing: " + "some words " * 20
    peer({"ok": True, "status": status})
    lines = calibctl("status", "front").out.splitlines()
    assert all(len(line) <= 100 for line in lines if "aaaa" not in line)
    assert all(line[16:18] == ": " for line in lines if line)
    first = lines.index("Reason          : sensor_silent: no image arrived")
    assert lines[first + 1].startswith("                : a detail of many words a detail")
    assert lines[first + 4] == "                : \\x1b[31mthe last one"
    assert any(line.startswith("Remark          : /points: row_step is \\x1b[31m0, and so on") for line in lines)
    shown = " ".join(line[18:] for line in lines)
    assert "(malformed:row_step, 7 times)" in shown
    assert shown.count("a detail of many words") == 10 and shown.count("some words") == 20
    assert all(f"malformed:reason_{number} 1000000" in shown for number in range(20))


@pytest.mark.parametrize("change", [
    {"since_boot_s": -3601}, {"since_boot_s": 3600}, {"boot_id": "of another boot"}, {"pairs": 2}, {"not_written": "disk full"},
    None], ids=str)
def test_a_verdict_without_valid_evidence_is_not_shown(calibctl, peer, schema, change):
    status = json.loads(calibctl.snapshot.read_text())
    pair = status["pairs"][0]
    if change is None:
        pair["evidence"] = None
    else:
        for key, value in change.items():
            pair["evidence"][key] = pair["evidence"][key] + value if key == "since_boot_s" else value
    calibctl.snapshot.write_text(json.dumps(status))
    for running in (False, True):
        if running:
            peer({"ok": True, "status": status})
        shown = json.loads(calibctl("status", "--json").out)
        schema("status", shown)
        assert shown["pairs"][0]["verdict"] == "not_evaluated"
        assert shown["pairs"][0]["reason"].endswith("; it was calibrated when last evaluated")
        assert "Verdict         : not evaluated" in calibctl("status", "front").out
        assert row_of("front", calibctl("status").out)[1] == "not evaluated"
    assert calibctl("status", "--exit-code").exit == NO


@pytest.mark.parametrize("spoil", [
    "UPDATE record SET canonical = replace(canonical, 'calibd', 'nobody') WHERE sequence = 3",
    "DELETE FROM record WHERE sequence = 3"])
def test_a_record_that_does_not_verify_is_not_shown_as_verified(calibctl, spoil):
    with sqlite3.connect(calibctl.store) as database:
        assert database.execute(spoil).rowcount == 1
    shown = calibctl("status", "--json")
    assert shown.exit == NO
    record = json.loads(shown.out)["pairs"][0]["record"]
    assert record["verified"] is False and record["verified_by"] == "calibctl"
    assert "NOT VERIFIED" in calibctl("status", "front").out
    table = calibctl("status").out
    assert row_of("front", table)[4] == "3 UNVERIFIED" and "front: record NOT VERIFIED: " in table


@pytest.mark.parametrize("change", [
    lambda pair: pair["T_camera_lidar"]["translation_m"].__setitem__(0, 0.26),
    lambda pair: pair["record"].__setitem__("sequence", 2),
    lambda pair: pair["record"].__setitem__("sequence", 4),
    lambda pair: pair.__setitem__("name", "rear")])
def test_a_snapshot_that_differs_from_its_record_is_not_verified(calibctl, change):
    status = json.loads(calibctl.snapshot.read_text())
    change(status["pairs"][0])
    calibctl.snapshot.write_text(json.dumps(status))
    shown = calibctl("status", "--json")
    assert shown.exit == NO
    assert json.loads(shown.out)["pairs"][0]["record"]["verified"] is False


def test_a_snapshot_that_cannot_be_checked_is_verified_by_nobody(calibctl):
    calibctl.public_key.unlink()
    shown = calibctl("status", "--json")
    assert shown.exit == NOT_FOUND
    record = json.loads(shown.out)["pairs"][0]["record"]
    assert record["verified"] is False and record["verified_by"] == "nobody"


def test_verification_by_the_daemon_is_distinguished_from_that_by_calibctl(calibctl, peer, schema):
    peer({"ok": True, "status": json.loads(calibctl.snapshot.read_text())})
    status = json.loads(calibctl("status", "--json").out)
    schema("status", status)
    assert status["daemon"]["running"] is True
    assert status["pairs"][0]["record"]["verified_by"] == "calibctl"
    calibctl.public_key.unlink()
    shown = calibctl("status", "front")
    assert shown.exit == DONE and "verified by calibd, not checked by calibctl" in shown.out
    assert row_of("front", calibctl("status").out)[4] == "3 by calibd"


@pytest.mark.parametrize("verdict, exit_code", [("calibrated", DONE), ("suspect", NO), ("drifted", NO), ("not_evaluated", NO)])
def test_the_exit_code_follows_the_verdict_on_request(calibctl, bin_dir, peer, verdict, exit_code):
    calibctl.store.unlink()
    write_store(bin_dir, calibctl, verdict)
    peer({"ok": True, "status": json.loads(calibctl.snapshot.read_text())})
    assert calibctl("status").exit == DONE
    assert calibctl("status", "--exit-code").exit == exit_code


def test_no_daemon_and_no_snapshot(bare):
    for command in (["status"], ["recalibrate", "front"], ["accept", "front"], ["rollback", "front"]):
        ended = bare(*command)
        assert ended.exit == NOT_FOUND and ended.out == "" and "does not run" in ended.err


@pytest.mark.parametrize("content", [b"", b"{}", b"[1,2]", b"\xff\xfe", b'{"schema":2}', b"[" * 100_000])
def test_an_invalid_snapshot_is_a_failure(calibctl, content):
    calibctl.snapshot.write_bytes(content)
    ended = calibctl("status")
    assert ended.exit == FAILED and ended.out == ""


@pytest.mark.parametrize("reply", [
    b"", b"\n", b"hello\n", b"{}\n", b"[]\n", b'{"ok":1}\n', b'{"ok":false}\n', b'{"ok":true}\n', b'{"ok":true,"status":7}\n',
    b'{"ok":true,"status":{}}', b'{"ok":false,"code":1,"message":2}\n', b"\xff\n", b"x" * (5 << 20)])
def test_an_invalid_answer_is_a_failure(calibctl, peer, reply):
    peer(reply)
    for command in (["status"], ["recalibrate", "front"], ["accept", "front"], ["rollback", "front"], ["doctor"]):
        ended = calibctl(*command)
        assert ended.exit == FAILED and ended.out == "" and ended.err.startswith("calibctl: ")


@pytest.mark.parametrize("code, exit_code", [("not_found", NOT_FOUND), ("bad_request", USAGE), ("not_ready", FAILED),
                                             ("denied", FAILED), ("failed", FAILED)])
def test_a_refusal_has_an_exit_code_and_prints_its_message(calibctl, peer, code, exit_code):
    peer({"ok": False, "code": code, "message": "because \x1b[31m"})
    ended = calibctl("recalibrate", "front")
    assert ended.exit == exit_code and ended.err == "calibctl: because \\x1b[31m\n"


RESULT = {"T_camera_lidar": {"translation_m": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1]},
          "change": {"rotation_deg": [0.0, 0.0, -1.0], "translation_cm": [0.0, 0.0, 2.0]},
          "score": {"before": 0.1, "after": 0.2, "held_back_before": 0.1, "held_back_after": 0.2}}


@pytest.mark.parametrize("answer, exit_code", [
    ({"answer": "accepted"}, DONE), ({"answer": "proposed"}, DONE), ({"answer": "rolled_back"}, DONE),
    ({"answer": "rejected"}, NO), ({"answer": "dry_run", "would": "accepted"}, DONE),
    ({"answer": "dry_run", "would": "rejected"}, NO)])
def test_the_exit_code_follows_the_decision(calibctl, peer, answer, exit_code):
    peer({"ok": True, "reason": "words", "record": 4, "result": RESULT, **answer})
    ended = calibctl("recalibrate", "front")
    assert ended.exit == exit_code
    assert "1.00 degrees to the right" in ended.out and "2.0 cm up" in ended.out


def diagnosis(**results):
    return {"ok": True, "overlays": [], "checks": [
        {"pair": "front", "check": check, "result": result, "seen": "words \x1b[31m",
         **({"code": "code", "cause": "of it", "remedy": "for it"} if result in ("problem", "warning") else {})}
        for check, result in results.items()]}


@pytest.mark.parametrize("results, exit_code", [
    ({"extrinsic": "ok", "agreement": "ok", "lens": "not_checked"}, DONE), ({"agreement": "ok", "scene": "warning"}, DONE),
    ({"extrinsic": "ok", "agreement": "ok", "lens": "problem"}, FAILED), ({"extrinsic": "not_checked"}, NO),
    ({"extrinsic": "ok", "agreement": "not_checked", "scene": "warning"}, NO)])
def test_the_exit_code_follows_the_findings(calibctl, peer, results, exit_code):
    peer(diagnosis(**results))
    ended = calibctl("doctor")
    assert ended.exit == exit_code
    assert "\x1b" not in ended.out and ": words \\x1b[31m\n" in ended.out


@pytest.mark.parametrize("reply", [
    {"ok": True, "checks": [], "overlays": []}, {"ok": True, "checks": [{"pair": "front"}], "overlays": []},
    {**diagnosis(extrinsic="splendid")}, {**diagnosis(extrinsic="ok"), "overlays": [7]}])
def test_an_invalid_diagnosis_is_a_failure(calibctl, peer, reply):
    peer(reply)
    ended = calibctl("doctor")
    assert ended.exit == FAILED and ended.out == "" and "not understood" in ended.err


def test_a_picture_that_cannot_be_copied_is_a_failure(calibctl, peer, tmp_path):
    peer({**diagnosis(agreement="ok"), "overlays": [{"pair": "front", "file": "/nowhere/front.png"}]})
    ended = calibctl("doctor", "--overlay", tmp_path / "pictures")
    assert ended.exit == FAILED and "/nowhere/front.png cannot be copied" in ended.err


@pytest.mark.parametrize("arguments, question", [
    (["status"], {"request": "status"}),
    (["doctor"], {"request": "doctor", "pair": None}),
    (["doctor", "front", "--json"], {"request": "doctor", "pair": "front"}),
    (["recalibrate", "front"], {"request": "recalibrate", "pair": "front", "dry_run": False}),
    (["recalibrate", "front", "--dry-run"], {"request": "recalibrate", "pair": "front", "dry_run": True}),
    (["accept", 'a "pair"'], {"request": "accept", "pair": 'a "pair"'}),
    (["rollback", "front"], {"request": "rollback", "pair": "front", "to": None}),
    (["rollback", "front", "--to", "3"], {"request": "rollback", "pair": "front", "to": 3})])
def test_requests_are_the_documented_ones(calibctl, peer, arguments, question):
    listening = peer({"ok": False, "code": "failed", "message": "no"})
    calibctl(*arguments)
    assert [json.loads(line) for line in listening.questions] == [{"schema": 1, **question}]
    assert all(line.endswith(b"\n") for line in listening.questions)
