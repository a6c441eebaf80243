"""kill -9 at any moment: calibd goes on within two seconds; no decision is lost, and no evidence that was written."""

import json
import random
import sqlite3
import time

from drive import Drive


def decided(folder):
    """Pairs that had been evaluated when the state in the store was written."""
    with sqlite3.connect(f"file:{folder}/state/calibd.db?mode=ro", uri=True) as store:
        text, = store.execute("select json from state").fetchone()
    return json.loads(text[text.index("{"):])["evaluated"]


def kept(folder):
    """Records and alerts as they lie in the store, which a reader may open at any time."""
    with sqlite3.connect(f"file:{folder}/state/calibd.db?mode=ro", uri=True) as store:
        tables = [name for (name,) in store.execute("select name from sqlite_master where type = 'table'")]
        return {name: store.execute(f"select count(*) from {name}").fetchone()[0] for name in tables}


def test_a_killed_daemon_goes_on_where_it_was(bin_dir, tmp_path, dds_domain, slowdown):
    moments = random.Random(7)
    with Drive(bin_dir, tmp_path, dds_domain, "calib-sim", "--knock-deg", "0,1,0", "--after-frames", 60,
               configure=lambda text: text.replace("frames: 25", "frames: 8")) as drive:
        killed, sequences = 0, []
        while not sequences or sequences[-1] < 2 or killed < 12:
            drive.wait_for(lambda _: True, 30)
            time.sleep(moments.uniform(0, 16 * slowdown))  # some of the time enough to recalibrate
            before, counts, evaluated = drive.status(), kept(tmp_path), decided(tmp_path)
            drive.kill_calibd()
            killed += 1
            drive.start_calibd()
            restarted = time.monotonic()
            after = drive.wait_for(lambda _: True, 10)
            assert time.monotonic() - restarted < 2 * slowdown, drive.log()
            # Between the last look and the kill a pair more may have been evaluated. What led to a decision is there
            # again; of what came since a minute may be lost, which is longer than these runs last.
            assert after["evaluated"] >= evaluated and after["record"]["sequence"] >= before["record"]["sequence"]
            if after["record"] == before["record"]:
                assert after["T_camera_lidar"] == before["T_camera_lidar"]
            # What was known is there again; what is claimed rests on what this run has seen.
            assert after["verdict"] != "calibrated" or after["evidence"]["pairs"] >= 3
            assert all(kept(tmp_path)[table] >= count for table, count in counts.items())
            sequences.append(after["record"]["sequence"])
            assert killed < 60, drive.log()
        history = drive.ctl("history")
        assert history.returncode == 0, history.stdout + history.stderr
        assert drive.ctl("verify").returncode == 0
        snapshot = json.loads((tmp_path / "run/status.json").read_text())
        assert snapshot["pairs"][0]["record"]["verified"] is True
