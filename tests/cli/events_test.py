"""calibctl events: what happened, from each source that can be read, and which could not be."""

import json
import os
import shutil
import sqlite3

import pytest

from conftest import DONE, NO, NOT_FOUND, USAGE
from json_test import form  # noqa: F401, a fixture


def add_alert(calibctl, number, stamp, verdict, reason):
    alert = {"schema": 1, "alert_sequence": number, "stamp": stamp, "vehicle": "v", "pair": "front", "verdict": verdict,
             "previous_verdict": "calibrated", "reason": reason, "rotation_rad": [0, 0, 0], "translation_m": [0, 0, 0],
             "sigma_rotation_rad": [None] * 3, "sigma_translation_m": [None] * 3, "record_sequence": 3}
    with sqlite3.connect(calibctl.store) as store:
        table = [name for name, in store.execute("select name from sqlite_master where type = 'table'")
                 if name in ("alert", "outbox")][0]
        store.execute(f"insert into {table} (sequence, json) values (?, ?)", (number, json.dumps(alert)))


@pytest.fixture
def journal(calibctl):
    """An empty folder of journal files."""
    folder = calibctl.folder / "journal"
    folder.mkdir()
    return ["--journal", folder]


def rows_of(shown):
    return [line.split() for line in shown.out.splitlines()[1:] if not line.startswith(" ")]


def test_records_and_alerts_are_listed_in_order_of_time(calibctl, journal, form):
    add_alert(calibctl, 1, "2026-01-31T12:01:30.000000000Z", "drifted", "yaw\x1b[2J moved")
    shown = calibctl("events", *journal)
    assert shown.exit == DONE, shown
    assert all(len(line) <= 100 for line in shown.out.splitlines()) and "\x1b" not in shown.out
    assert [row[3:] for row in rows_of(shown)] == [
        ["initial", "record", "1,", "verified"], ["rejected", "record", "2,", "verified"], ["drifted", "alert", "1"],
        ["accepted", "record", "3,", "verified"]]
    found = form("events", calibctl("events", *journal, "--json").out)
    assert [event["source"] for event in found["events"]] == ["record", "record", "alert", "record"]
    assert [event["verified"] for event in found["events"]] == [True, True, False, True]
    assert all(source["complete"] for source in found["sources"])


def test_since_and_pair_choose(calibctl, journal):
    assert [row[3] for row in rows_of(calibctl("events", *journal, "--since", "2026-01-31T12:01:30Z"))] == ["accepted"]
    assert len(rows_of(calibctl("events", *journal, "--since", "2026-01-31"))) == 3
    assert calibctl("events", *journal, "--since", "2026-02-01").out == ""
    assert len(rows_of(calibctl("events", *journal, "--since", "36500d"))) in (0, 3)
    assert calibctl("events", *journal, "rear").out == ""
    for wrong in ("yesterday", "12", "2026-13-01"):
        assert calibctl("events", *journal, "--since", wrong).exit == USAGE


def test_a_source_that_cannot_be_read_is_named(calibctl, journal, form):
    gone = calibctl("events", "--journal", calibctl.folder / "nowhere")
    assert gone.exit == DONE and "journal not read: " in gone.err and len(rows_of(gone)) == 3
    calibctl.public_key.unlink()
    unverified = calibctl("events", *journal, "--json")
    assert unverified.exit == DONE and "records not read: " in unverified.err
    found = form("events", unverified.out)
    assert [source["complete"] for source in found["sources"]] == [False, True, True]
    shutil.rmtree(calibctl.folder / "journal")
    calibctl.store.unlink()
    nothing = calibctl("events", *journal)
    assert nothing.exit == NOT_FOUND and nothing.out == "" and len(nothing.err.splitlines()) == 3


def test_a_record_that_does_not_verify_is_no_event(calibctl, journal):
    with sqlite3.connect(calibctl.store) as store:
        store.execute("update record set canonical = replace(canonical, 'rejected', 'accepted') where sequence = 2")
    shown = calibctl("events", *journal)
    assert shown.exit == NO and "record 2 does not verify" in shown.err and [row[3] for row in rows_of(shown)] == ["initial"]


@pytest.mark.skipif(os.geteuid() != 0, reason="needs another user")
def test_a_user_who_may_not_read_the_store_is_told_so(calibctl, journal):
    calibctl.folder.chmod(0o755)
    for folder in calibctl.folder.parents[:3]:
        folder.chmod(0o755)
    calibctl.store.chmod(0o600)
    shown = calibctl("events", *journal, user=65534, group=65534, extra_groups=[])
    assert shown.exit in (DONE, NOT_FOUND)
    assert "alerts not read: only calibd and root may read" in shown.err and "records not read: " in shown.err
