"""status on a terminal: the table of all pairs, and --watch."""

import copy
import datetime
import fcntl
import json
import os
import pty
import re
import signal
import struct
import subprocess
import termios
import time

from conftest import DONE, NOT_FOUND, row_of


def of_four_pairs(status):
    """A status of four pairs, one of them in trouble."""
    front = status["pairs"][0]
    front["inputs"]["cloud"]["age_s"] = 0.75
    for name, change in (("rear", {"verdict": "drifted", "misalignment": None, "axes": None}),
                         ("left_of_the_roof", {"verdict": "suspect"}),
                         ("right", {"verdict": "not_evaluated", "cause": "dark", "reason": "dark: " + "many words " * 30,
                                    "misalignment": None, "axes": None,
                                    "proposed": {"T_camera_lidar": front["T_camera_lidar"], "record_sequence": 4}})):
        pair = copy.deepcopy(front)
        pair.update(name=name, reason="why " * 40, record=None)
        pair.update(change)
        status["pairs"].append(pair)
    status["pairs"][2]["misalignment"]["rotation_deg"] = [-12.5, 0.25, 0.1]
    status["pairs"][2]["misalignment"]["sigma_rotation_deg"] = [0.5, 0.25, 0.125]
    status["pairs"][2]["misalignment"]["translation_cm"] = [0, 0, 0]
    since = datetime.datetime.now(datetime.timezone.utc) - datetime.timedelta(minutes=34)
    status["pairs"][2]["since"] = since.strftime("%Y-%m-%dT%H:%M:%SZ")
    return status


def test_a_status_of_four_pairs_fits_a_screen(calibctl, peer):
    peer({"ok": True, "status": of_four_pairs(json.loads(calibctl.snapshot.read_text()))})
    shown = calibctl("status")
    lines = shown.out.splitlines()
    assert len(lines) <= 24 and all(len(line) <= 100 for line in lines), shown.out
    header = next(line for line in lines if line.startswith("PAIR "))
    assert re.split(r"  +", header) == ["PAIR", "VERDICT", "SINCE", "WORST AXIS", "RECORD", "DATA AGE"]
    rows = {name: lines[lines.index(header) + 1 + number] for number, name in
            enumerate(("front", "rear", "left_of_the_roof", "right"))}
    for name, row in rows.items():  # a column begins where its title does
        assert row.startswith(name)
        assert all(row[at - 1] == " " != row[at] for at in (header.index(title) for title in ("VERDICT", "SINCE", "WORST", "RECORD", "DATA")))
    assert row_of("front", shown.out)[3:] == ["y 2.0 +- 0.1 cm to the left", "3 verified", "0.8 s"]
    assert row_of("rear", shown.out)[1] == "drifted" and row_of("rear", shown.out)[3] == "not estimated yet"
    assert row_of("left_of_the_roof", shown.out)[1:4] == ["suspect", "34 min", "roll 12.50 +- 0.50 deg left side down"]
    assert row_of("right", shown.out)[1] == "not evaluated" and row_of("right", shown.out)[3] == "-"
    assert any(line.startswith("right: dark: many words") and line.endswith("...") for line in lines)
    assert "right: record 4 is proposed, not in force; to put it in force: calibctl accept right" in lines
    rear = calibctl("status", "rear").out
    assert "LiDAR has moved : not estimated yet\n" in rear and "front" not in rear


def test_a_pair_can_be_asked_for_alone(calibctl, peer, schema):
    peer({"ok": True, "status": of_four_pairs(json.loads(calibctl.snapshot.read_text()))})
    status = json.loads(calibctl("status", "front", "--json").out)
    schema("status", status)
    assert [pair["name"] for pair in status["pairs"]] == ["front"]
    assert calibctl("status", "front", "--exit-code").exit == DONE
    unknown = calibctl("status", "roof\x1b[2J")
    assert unknown.exit == NOT_FOUND and unknown.out == ""
    assert unknown.err == "calibctl: there is no pair 'roof\\x1b[2J'; there is: front, rear, left_of_the_roof, right\n"


def test_the_data_of_a_snapshot_age_with_it(calibctl):
    status = json.loads(calibctl.snapshot.read_text())
    status["pairs"][0]["inputs"]["cloud"]["age_s"] = 2
    calibctl.snapshot.write_text(json.dumps(status))
    os.utime(calibctl.snapshot, (time.time() - 3600, time.time() - 3600))
    assert row_of("front", calibctl("status").out)[5] == "60 min"


def on_terminal(command, environment, enough, rows=24):
    """What `command` writes to a terminal until `enough(seen)` and then to its end, and the exit after an interrupt."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("HHHH", rows, 100, 0, 0))
    running = subprocess.Popen(command, stdin=slave, stdout=slave, stderr=slave, env={**os.environ, **environment})
    os.close(slave)
    seen = b""
    try:
        while not enough(seen):
            seen += os.read(master, 65536)
        running.send_signal(signal.SIGINT)
        exit_code = running.wait(timeout=20)
        try:
            while more := os.read(master, 65536):
                seen += more
        except OSError:
            pass  # the end of a terminal that nobody has open any more
    finally:
        running.kill()
        os.close(master)
    return seen, exit_code


def test_watch_redraws_in_place_and_leaves_the_terminal_as_it_was(calibctl):
    seen, exit_code = on_terminal(calibctl.command("status", "--watch"), {"TERM": "xterm"},
                                  lambda seen: seen.count(b"\x1b[HVehicle") == 2)
    assert exit_code == DONE
    enter, leave = b"\x1b[?1049h\x1b[?25l\x1b[?7l", b"\x1b[?7h\x1b[?25h\x1b[?1049l"
    assert seen.startswith(enter) and seen.endswith(leave) and seen.count(enter) == seen.count(leave) == 1
    assert b"\x1b[2J" not in seen, "the screen is not cleared"
    drawn = [row for row in seen.split(b"\x1b[HVehicle")[1].split(b"\r\n") if row]
    assert all(row.rstrip(b"\r").removesuffix(b"\x1b[J").endswith(b"\x1b[K") for row in drawn), "each row is overwritten to its end"


def test_watch_shows_as_many_rows_as_the_terminal_has(calibctl):
    seen, exit_code = on_terminal(calibctl.command("status", "--watch"), {"TERM": "xterm"},
                                  lambda seen: seen.count(b"\x1b[HVehicle") == 2, rows=3)
    assert exit_code == DONE
    assert seen.split(b"\x1b[HVehicle")[1].count(b"\r\n") == 2 and b"VERDICT" not in seen


def test_watch_on_a_terminal_that_cannot_redraw_repeats_the_status(calibctl):
    seen, exit_code = on_terminal(calibctl.command("status", "--watch"), {"TERM": "dumb"},
                                  lambda seen: seen.count(b"Vehicle") == 2)
    assert exit_code == DONE and b"\x1b" not in seen
    with subprocess.Popen(calibctl.command("status", "--watch"), stdout=subprocess.PIPE) as running:
        heads = [line for line in (running.stdout.readline() for _ in range(14)) if line.startswith(b"Vehicle")]
        running.send_signal(signal.SIGINT)
        assert running.wait(timeout=20) == DONE and len(heads) == 2


def test_a_watch_that_is_stopped_gives_the_terminal_back_and_goes_on(calibctl):
    master, slave = pty.openpty()
    running = subprocess.Popen(calibctl.command("status", "--watch"), stdin=slave, stdout=slave, stderr=slave,
                               env={**os.environ, "TERM": "xterm"})
    os.close(slave)
    seen = b""
    try:
        for number, expected in ((signal.SIGTSTP, b"DATA AGE"), (signal.SIGCONT, b"\x1b[?1049l"), (signal.SIGHUP, b"DATA AGE")):
            while expected not in seen:
                seen += os.read(master, 65536)
            seen = b""
            running.send_signal(number)
            if number == signal.SIGTSTP:
                assert os.WIFSTOPPED(os.waitpid(running.pid, os.WUNTRACED)[1])
        assert running.wait(timeout=20) == DONE
    finally:
        running.kill()
        os.close(master)


def test_the_verdict_is_coloured_on_a_terminal_only(calibctl):
    command = calibctl.command("status", "--watch")

    def all_shown(seen):
        return b"never" in seen

    seen, _ = on_terminal(command, {"TERM": "xterm", "NO_COLOR": ""}, all_shown)
    assert b"\x1b[32mcalibrated\x1b[0m" in seen
    seen, _ = on_terminal(command, {"TERM": "xterm", "NO_COLOR": "1"}, all_shown)
    assert b"calibrated" in seen and b"\x1b[32m" not in seen
    assert "\x1b" not in calibctl("status").out


def test_watch_with_json_prints_a_line_a_second(calibctl):
    with subprocess.Popen(calibctl.command("status", "--json", "--watch"), stdout=subprocess.PIPE) as running:
        first, second = (json.loads(running.stdout.readline()) for _ in range(2))
        running.send_signal(signal.SIGTERM)
        assert running.wait(timeout=20) == DONE
    assert 0.5 < second["daemon"]["snapshot_age_s"] - first["daemon"]["snapshot_age_s"] < 10
