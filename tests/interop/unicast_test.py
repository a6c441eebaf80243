"""Where the network lets no multicast through, calibd and the sensors find each other by the addresses that they are told."""

import json
import os
import subprocess
import sys
import textwrap

import pytest

pytest.importorskip("cyclonedds", reason="no cyclonedds package for this machine")
import vehicle  # noqa: E402

UNICAST = ('<CycloneDDS><Domain><General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces>'
           '<AllowMulticast>false</AllowMulticast></General><Discovery><ParticipantIndex>auto</ParticipantIndex>'
           '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>')
# A program of its own: a process has one configuration for a domain.
DRIVER = textwrap.dedent("""
    import sys, time
    import ros, vehicle
    ros.LOOPBACK = sys.argv[2]
    peer = ros.Peer(int(sys.argv[1]))
    with vehicle.Vehicle(peer, vehicle.render(6)):
        time.sleep(float(sys.argv[3]))
""")


@pytest.fixture(name="sensors")
def fixture_sensors(source_dir, dds_domain, slowdown):
    environment = os.environ | {"PYTHONPATH": str(source_dir / "tests/interop")}
    driver = subprocess.Popen([sys.executable, "-c", DRIVER, str(dds_domain), UNICAST, str(120 * slowdown)], env=environment)
    yield driver
    driver.kill()
    driver.wait()


def test_pairs_are_evaluated_without_multicast(bin_dir, dds_domain, tmp_path, sensors):
    config = vehicle.configuration(tmp_path, dds_domain, "500ms", "500ms")
    config["dds"] |= {"multicast": False, "peers": ["127.0.0.1"]}
    with vehicle.Calibd(bin_dir, tmp_path, config) as daemon:
        daemon.wait_for(lambda: daemon.pair()["evaluated"] >= 2, 90)
    assert sensors.poll() is None


def test_a_configuration_of_cyclone_that_is_not_read_is_told(bin_dir, dds_domain, tmp_path, monkeypatch):
    monkeypatch.setitem(vehicle.Calibd.ENVIRONMENT, "CYCLONEDDS_URI", "<CycloneDDS/>")
    with vehicle.Calibd(bin_dir, tmp_path, vehicle.configuration(tmp_path, dds_domain)) as daemon:
        daemon.wait_for(daemon.pairs, 30)
        daemon.wait_for(lambda: "CYCLONEDDS_URI is set, and calibd does not read it" in daemon.log(), 30)


@pytest.mark.parametrize("dds,part", [({"multicast": False}, "dds.multicast: is false, so that peers must say"),
                                      ({"peers": ["a b"]}, "dds.peers[0]: needs a host name or an address"),
                                      ({"peers": ["h"] * 33}, "dds.peers: has 33 addresses where 32 are allowed")])
def test_peers_that_cannot_be_are_refused(bin_dir, tmp_path, dds, part):
    config = vehicle.configuration(tmp_path, 0)
    config["dds"] |= dds
    file = tmp_path / "calibd.yaml"
    file.write_text(json.dumps(config))
    checked = subprocess.run([bin_dir / "calibd", "--check-config", "--config", file], capture_output=True, text=True, check=False)
    assert checked.returncode == 78 and part in checked.stderr, checked.stderr
