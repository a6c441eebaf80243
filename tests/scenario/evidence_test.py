"""calibd never says `calibrated` without evidence: with the real programs, one fault after the other."""

import json
import os
import shutil
import signal
import sqlite3
import time

from drive import Drive
from support.frozen import Frozen, thread_of


def calibrated(pair):
    return pair["verdict"] == "calibrated"


def said(drive, seconds, *words):
    return drive.wait_for(lambda pair: pair["verdict"] == "not_evaluated" and all(word in pair["reason"] for word in words), seconds)


def start_alone(drive):
    """calibd once more, with what it said since."""
    before = len(drive.log())
    drive.start_calibd()
    return lambda: drive.log()[before:]


def test_no_fault_leaves_an_ok_without_evidence(bin_dir, tmp_path, dds_domain):
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim") as drive:
        first = drive.wait_for(calibrated, 90)
        assert first["evidence"]["pairs"] >= 20 and drive.ctl("status", "--exit-code").returncode == 0

        # Somebody else's write lock: the store cannot be written.
        with sqlite3.connect(tmp_path / "state/calibd.db") as store:
            store.execute("begin immediate")
            said(drive, 5, "store_failed", "locked", "it was calibrated when last evaluated")
            assert drive.ctl("status", "--exit-code").returncode == 4
            store.rollback()
        drive.wait_for(calibrated, 10)
        assert oct(os.stat(tmp_path / "state/calibd.db").st_mode)[-3:] == "600"

        # The thread that evaluates hangs: the other one shows it, in the file too.
        with Frozen(thread_of(drive.calibd.pid, "pairs")):
            said(drive, 10, "stale: ", "it was calibrated when last evaluated")
            deadline = time.monotonic() + 5
            while json.loads((tmp_path / "run/status.json").read_text())["pairs"][0]["verdict"] != "not_evaluated":
                assert time.monotonic() < deadline
                time.sleep(0.05)
        drive.wait_for(calibrated, 10)

        # A start: nothing is claimed from memory.
        drive.kill_calibd()
        drive.start_calibd()
        after = drive.wait_for(lambda _: True, 10)
        assert not calibrated(after) or after["evidence"]["pairs"] >= 3
        drive.wait_for(calibrated, 20)

        # Another lens: what was learned with the one before is worth nothing.
        drive.kill_calibd()
        text = drive.config.read_text()
        drive.config.write_text(text.replace("477.7", "477.8"))
        assert drive.config.read_text() != text
        log = start_alone(drive)
        again = drive.wait_for(lambda pair: pair["evidence"], 20)
        assert not calibrated(again) and "evidence is set aside" in log()
        relearned = drive.wait_for(calibrated, 90)
        assert relearned["evidence"]["evidence_sha256"] != first["evidence"]["evidence_sha256"]
        assert json.loads(drive.ctl("show", "--json").stdout)["evidence_sha256"] == relearned["evidence"]["evidence_sha256"]

        # The state folder goes away under the daemon: it ends, and the next start says what is missing.
        shutil.rmtree(tmp_path / "state")
        assert drive.calibd.wait(20) == 1 and "was removed or replaced" in drive.log()
        log = start_alone(drive)
        bare = drive.wait_for(lambda _: True, 10)
        assert not calibrated(bare) and "which calibd had written, are missing" in log()
        assert "are missing" in json.loads(drive.ctl("status", "--json").stdout)["records"]["missing"]
        assert "are missing" in json.loads(drive.ctl("show", "1", "--json").stdout)["reason"]
        drive.wait_for(calibrated, 90)

        # One chain, one vehicle.
        drive.calibd.send_signal(signal.SIGTERM)
        assert drive.calibd.wait(10) == 0
        text = drive.config.read_text()
        drive.config.write_text(text.replace("vehicle: scenario-car", "vehicle: another-car"))
        log = start_alone(drive)
        assert drive.calibd.wait(10) == 78 and "are of vehicle 'scenario-car'" in log()
        drive.config.write_text(text)

        # An end is obeyed though the work hangs.
        drive.start_calibd()
        drive.wait_for(calibrated, 30)
        worker = Frozen(thread_of(drive.calibd.pid, "pairs"))
        worker.__enter__()
        started = time.monotonic()
        drive.calibd.send_signal(signal.SIGTERM)
        worker.wait_for_end(3)
        assert drive.calibd.wait(3) == 0 and time.monotonic() - started < 3
        drive.start_calibd()
        drive.wait_for(lambda _: True, 10)
