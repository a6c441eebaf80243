"""calibctl alerts: what waits for the fleet, for people."""

import json
import signal
import socket
import subprocess
import threading

import pytest

from conftest import DONE, FAILED, NOT_FOUND


def event(sequence, kind="drift.confirmed", data=None, **attributes):
    text = {"specversion": "1.0", "id": f"demo-car-{sequence}", "type": f"calibd.{kind}.v1", "subject": "front",
            "time": "2026-11-27T21:01:16.105Z", "data": data or {"reason": "yaw \x1b[31m1.08 degrees"}} | attributes
    return {"sequence": sequence, "priority": "alert", "event": json.dumps(text)}


class Daemon:
    """Answers `feed` and `acknowledge` as calibd does."""

    def __init__(self, path, events):
        self.events, self.acknowledged, self.ended = events, [], threading.Event()
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.bind(str(path))
        self.socket.listen()
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def close(self):
        self.ended.set()
        self.socket.shutdown(socket.SHUT_RDWR)
        self.thread.join()
        self.socket.close()

    def _serve(self):
        while not self.ended.is_set():
            try:
                connection, _ = self.socket.accept()
            except OSError:
                return
            with connection:
                request = json.loads(connection.makefile("rb").readline())
                connection.sendall(json.dumps(self._answer(request)).encode() + b"\n")

    def _answer(self, request):
        if request["request"] == "acknowledge":
            assert request["run"] == "run-1"
            self.acknowledged.append(request["through"])
            return {"ok": True, "waiting": 0}
        if request["wait"]:
            self.ended.wait(1)
        return {"ok": True, "vehicle": "demo-car", "run": "run-1", "waiting": len(self.events),
                "events": [one for one in self.events if one["sequence"] > request["after"]][:2]}


@pytest.fixture
def daemon(calibctl):
    made = Daemon(calibctl.socket, [
        event(3), event(4, "feed.gap", {"from": 1, "to": 2}, subject=None), event(7, "drift.cleared"),
        event(8, "feed.state", {"pairs": [{"name": "front", "verdict": "calibrated"}]}, subject=None),
        {"sequence": 9, "priority": "alert", "event": "spoilt"}])
    for one in made.events[1], made.events[3]:
        text = json.loads(one["event"])
        del text["subject"]
        one["event"] = json.dumps(text)
    yield made
    made.close()


def test_all_that_waits_is_listed_and_stays(calibctl, daemon):
    shown = calibctl("alerts")
    assert shown.exit == DONE, shown.err
    lines = [line.split() for line in shown.out.splitlines() if line[:1].isdigit()]
    assert [(line[0], line[-1]) for line in lines] == [
        ("3", "confirmed"), ("4", "gap"), ("7", "cleared"), ("8", "state"), ("9", "unreadable")]
    assert lines[0] == ["3", "2026-11-27", "21:01:16", "front", "confirmed"]
    assert "\\x1b[31m1.08 degrees" in shown.out and "\x1b" not in shown.out
    assert "events 1 to 2 were lost" in shown.out and "front calibrated" in shown.out
    assert daemon.acknowledged == []


def test_what_was_printed_is_acknowledged_on_request(calibctl, daemon):
    shown = calibctl("alerts", "--json", "--ack")
    assert shown.exit == DONE, shown.err
    assert json.loads(shown.out.splitlines()[0])["id"] == "demo-car-3"
    assert daemon.acknowledged == [4, 8, 9]


def test_what_could_not_be_printed_is_not_acknowledged(calibctl, daemon):
    with open("/dev/full", "wb") as full:
        ended = subprocess.run(calibctl.command("alerts", "--ack"), stdout=full, stderr=subprocess.PIPE, timeout=60,
                               check=False)
    assert ended.returncode == FAILED and b"stay in the outbox" in ended.stderr
    assert daemon.acknowledged == []


def test_follow_goes_on_until_it_is_interrupted(calibctl, daemon):
    with subprocess.Popen(calibctl.command("alerts", "--follow", "--json"), stdout=subprocess.PIPE, text=True) as following:
        for expected in ("demo-car-3", "demo-car-4", "demo-car-7", "demo-car-8"):
            assert json.loads(following.stdout.readline())["id"] == expected
        following.stdout.readline()  # the one that is spoilt
        daemon.events.append(event(12))
        assert json.loads(following.stdout.readline())["id"] == "demo-car-12"
        following.send_signal(signal.SIGINT)


def test_without_a_daemon_there_is_nothing_to_list(calibctl):
    assert calibctl("alerts").exit == NOT_FOUND
    assert calibctl("alerts", "--follow").exit == NOT_FOUND
