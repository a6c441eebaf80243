"""calibd.service under a systemd of its own: what an operator sees of `systemctl` and `journalctl`."""

import re
import shutil
import time

import pytest

from support.systemd_box import Box

CONFIGURATION = """vehicle: box-car
dds: {domain: 7, interface: lo}
sampling: {period: 500ms, window: 100ms}
pairs:
  - name: front
    camera: {image: /left, model: rectified, size: [640, 192], intrinsics: [400, 400, 320, 96]}
    lidar: {cloud: /points}
    T_camera_lidar: {translation_m: [0, 0, 0], quaternion_xyzw: [0.5, -0.5, 0.5, 0.5]}
    depth: {source: stereo, right_image: /right, baseline_m: 0.5}
"""
CONFIG, KEY = "/etc/calibd/calibd.yaml", "/etc/calibd/signing.key"


@pytest.fixture(scope="module")
def machine(bin_dir, source_dir, tmp_path_factory):
    """A systemd with calibd and its unit in the places of the package."""
    box = Box.make(tmp_path_factory.mktemp("box"))
    if box is None:
        pytest.skip("no systemd can be started here: that takes root, unshare and overlayfs")
    try:
        text = (bin_dir.parent / "systemd/calibd.service").read_text()
        (box.root / "usr/lib/systemd/system/calibd.service").write_text(text)
        for line in ("ExecStart", "ExecReload"):
            program = re.search(rf"^{line}=(\S+)", text, re.MULTILINE).group(1)
            shutil.copy(bin_dir / program.rsplit("/", 1)[1], box.root / program.lstrip("/"))
        for folder in (bin_dir.parent / "lib").glob("*/calibd"):
            shutil.copytree(folder, box.root / "usr/lib" / folder.parent.name / "calibd", dirs_exist_ok=True)
        shutil.copy(source_dir / "systemd/calibd.sysusers", box.root / "usr/lib/sysusers.d/calibd.conf")
        box.run("systemd-sysusers", "calibd.conf", check=True)
        box.run("systemctl", "daemon-reload", check=True)
        yield box
    finally:
        box.close()


@pytest.fixture
def service(machine):
    """The unit, stopped, with a good configuration and a new key."""
    machine.run("systemctl", "stop", "calibd")
    machine.run("systemctl", "reset-failed", "calibd")
    machine.run("rm", "-rf", "/etc/calibd", "/var/lib/calibd", "/var/lib/calibd-head")
    machine.write(CONFIG, CONFIGURATION)
    machine.run("calibctl", "keygen", "--out", KEY, check=True)
    machine.run("journalctl", "--rotate", check=True)
    machine.run("journalctl", "--vacuum-time=1us", check=True)
    yield machine
    machine.run("systemctl", "stop", "calibd")


def until(condition, seconds=20):
    deadline = time.monotonic() + seconds
    while not (found := condition()):
        assert time.monotonic() < deadline, "it has not come to pass in time"
        time.sleep(0.1)
    return found


def lines_of_calibd(box):
    return [entry["MESSAGE"] for entry in box.journal("calibd") if entry.get("SYSLOG_IDENTIFIER") == "calibd"]


def test_the_service_runs_and_shows_its_verdicts(service):
    service.run("systemctl", "start", "calibd", check=True)
    shown = until(lambda: "front: not_evaluated" in service.show("calibd", "StatusText")["StatusText"] and
                  service.show("calibd", "StatusText", "ActiveState", "NRestarts"))
    assert shown["ActiveState"] == "active" and shown["NRestarts"] == "0"
    assert service.run("calibctl", "status").returncode == 0
    assert "front: not_evaluated" in service.run("systemctl", "status", "calibd").out


def remove_key(box):
    box.run("rm", KEY, check=True)


def replace_key(text, mode=0o600):
    return lambda box: box.write(KEY, text, mode)


@pytest.mark.parametrize("break_it, words", [
    (remove_key, f"{KEY} does not exist; make one with `calibctl keygen --out {KEY}`"),
    (replace_key("untrusted comment: nothing\nabc\n"), f"{KEY} by default; put the vehicle's key there"),
    (replace_key("\n"), f"{KEY} by default; put the vehicle's key there"),
], ids=["missing", "no key", "empty"])
def test_a_key_that_is_missing_or_wrong_ends_with_one_line_and_no_new_start(service, break_it, words):
    break_it(service)
    assert service.run("systemctl", "start", "calibd").returncode != 0
    time.sleep(3)  # RestartSec is 2 s
    shown = service.show("calibd", "ActiveState", "NRestarts", "ExecMainStatus")
    assert shown == {"ActiveState": "failed", "NRestarts": "0", "ExecMainStatus": "78"}
    lines = lines_of_calibd(service)
    assert len(lines) == 1 and words in lines[0], lines
    service.run("rm", "-f", KEY, KEY.replace(".key", ".pub"))
    service.run("calibctl", "keygen", "--out", KEY, check=True)
    service.run("systemctl", "start", "calibd", check=True)


def test_a_key_that_systemd_cannot_read_ends_without_new_starts(service):
    service.run("rm", KEY, check=True)
    service.run("ln", "-s", KEY, KEY, check=True)  # too many levels of links, even for root
    assert service.run("systemctl", "start", "calibd").returncode != 0
    time.sleep(3)
    shown = service.show("calibd", "ActiveState", "NRestarts", "ExecMainStatus")
    assert shown == {"ActiveState": "failed", "NRestarts": "0", "ExecMainStatus": "243"}
    assert any("credentials" in entry["MESSAGE"] for entry in service.journal("calibd"))


def test_reload_takes_over_what_it_can_and_names_the_rest(service):
    service.run("systemctl", "start", "calibd", check=True)
    pid = service.show("calibd", "MainPID")
    service.write(CONFIG, CONFIGURATION.replace("period: 500ms", "period: 300ms").replace("domain: 7", "domain: 8"))
    service.run("systemctl", "reload", "calibd", check=True)
    assert service.show("calibd", "MainPID", "ActiveState") == {**pid, "ActiveState": "active"}
    line, = [entry for entry in service.journal("calibd") if entry.get("MESSAGE_ID") == "3c1860a9956b4045b5cc7e80a81b9d5a"]
    assert "taken over: sampling.period" in line["MESSAGE"] and "needs a restart: dds.domain" in line["MESSAGE"]


def test_reload_of_a_wrong_configuration_fails_and_the_running_one_stays(service):
    service.run("systemctl", "start", "calibd", check=True)
    before = service.show("calibd", "MainPID")
    service.write(CONFIG, CONFIGURATION.replace("window:", "windo:"))
    refused = service.run("systemctl", "reload", "calibd")
    assert refused.returncode != 0
    shown = until(lambda: "not reloaded" in service.show("calibd", "StatusText")["StatusText"] and
                  service.show("calibd", "StatusText", "ActiveState", "MainPID"))
    assert f"{CONFIG}:3: sampling.windo" in shown["StatusText"]
    assert shown["ActiveState"] == "active" and shown["MainPID"] == before["MainPID"]
    entries = service.journal("calibd")
    line, = [entry for entry in entries if entry.get("MESSAGE_ID") == "45b4b2e5ee6947419aa12b66d3fc20c6"]
    assert f"{CONFIG}:3: sampling.windo" in line["MESSAGE"] and line["CAUSE"] == "bad_config"
    assert any(entry.get("SYSLOG_IDENTIFIER") == "calibctl" and "sampling.windo" in entry["MESSAGE"] for entry in entries)
    events = service.run("calibctl", "events", "--since", "1h", check=True).out
    assert re.search(r"- +error +journal\n +.*sampling.windo", events) and re.search(r"front +initial +record 1, verified", events)
    # Mended, it is not mentioned any more.
    service.write(CONFIG, CONFIGURATION)
    service.run("systemctl", "reload", "calibd", check=True)
    until(lambda: service.show("calibd", "StatusText")["StatusText"].startswith("front: "))


def test_sighup_never_ends_calibd(service):
    service.run("systemctl", "start", "calibd", check=True)
    before = service.show("calibd", "MainPID")
    for text in (CONFIGURATION, "nonsense", CONFIGURATION.replace("period: 500ms", "period: 400ms")):
        service.write(CONFIG, text)
        service.run("systemctl", "kill", "--signal=HUP", "--kill-who=main", "calibd", check=True)
        time.sleep(0.7)
    until(lambda: any("taken over: sampling.period" in line for line in lines_of_calibd(service)))
    assert service.show("calibd", "MainPID", "ActiveState", "NRestarts") == {**before, "ActiveState": "active", "NRestarts": "0"}


def test_a_domain_that_the_unit_may_not_open_says_so(service):
    drop_in = "/etc/systemd/system/calibd.service.d/no-network.conf"
    service.write(drop_in, "[Service]\nRestrictAddressFamilies=\nRestrictAddressFamilies=AF_UNIX\n")
    service.run("systemctl", "daemon-reload", check=True)
    try:
        assert service.run("systemctl", "start", "calibd").returncode != 0
        line = until(lambda: lines_of_calibd(service))[-1]
        assert "dds.domain: UDP port 9150 of domain 7 cannot be opened" in line and "RestrictAddressFamilies=" in line
    finally:
        service.run("rm", drop_in, check=True)
        service.run("systemctl", "daemon-reload", check=True)


def test_events_have_fields_in_the_journal(service):
    service.run("systemctl", "start", "calibd", check=True)
    service.run("calibctl", "rollback", "front", "--to", "1", check=True)
    found = service.run("journalctl", "PAIR=front", "VERDICT=not_evaluated", "RECORD=2", "-o", "cat", "--no-pager")
    assert "earlier extrinsic in force by record 2" in found.out, service.journal("calibd")
    entry, = [entry for entry in service.journal("calibd") if entry.get("RECORD") == "2"]
    assert entry["MESSAGE_ID"] == "748027cca09f48b6b0b7c6ae95c9f61b" and entry["CAUSE"] == "no_pair_yet" and entry["REASON"]
