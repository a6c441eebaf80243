"""Other programs of the domain ask each other about their types: calibd hears all of it, and lives."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("cyclonedds", reason="no cyclonedds package for this machine")
import ros  # noqa: E402
import vehicle  # noqa: E402

PAIRINGS = 100
FOREIGN_TYPES = Path(__file__).with_name("foreign_types.py")


@pytest.fixture
def daemon(bin_dir, tmp_path, dds_domain):
    """calibd, which no sensor feeds, and which answers at the end of the test as at its begin."""
    with vehicle.Calibd(bin_dir, tmp_path, vehicle.configuration(tmp_path, dds_domain, "500ms", "200ms")) as daemon:
        assert daemon.pair()["verdict"] == "not_evaluated"
        yield daemon
        assert daemon.alive(), "calibd has died"
        assert daemon.pair()["verdict"] == "not_evaluated"


def run_foreign(side, domain, **options):
    return subprocess.Popen([sys.executable, FOREIGN_TYPES, side, str(domain), str(PAIRINGS)], text=True,
                            stdin=subprocess.PIPE, stdout=subprocess.PIPE, **options)


def test_foreign_programs_with_differing_types_meet_on_topics_that_calibd_does_not_use(daemon, dds_domain, slowdown):
    with run_foreign("write", dds_domain) as writing, run_foreign("read", dds_domain, stderr=subprocess.PIPE) as reading:
        try:
            assert reading.wait(60 * slowdown) == 0, reading.stderr.read()
            assert daemon.alive(), "calibd has died"
        finally:
            reading.kill()
            writing.stdin.close()


@pytest.mark.parametrize("topic", ["rt/foreign", "rt/diagnostics"])
def test_somebody_asks_for_the_type_of_a_topic(daemon, dds_domain, topic):
    peer = ros.Peer(dds_domain)
    _foreign = peer.writer(ros.PointCloud2, "/foreign")
    asked = subprocess.run([Path(sys.executable).with_name("cyclonedds"), "typeof", "--suppress-progress-bar",
                            "--id", str(dds_domain), "--runtime", "2s", topic], capture_output=True, text=True, timeout=60,
                           env=os.environ | {"CYCLONEDDS_URI": ros.LOOPBACK})
    assert asked.returncode == 0, asked.stderr
    assert ("struct PointCloud2_" in asked.stdout) == (topic == "rt/foreign"), asked.stdout
