"""What calibd costs a vehicle, in two minutes and with wide margins: tests/bench/footprint holds it to its targets."""

import subprocess
import sys

import pytest

pytest.importorskip("cyclonedds", reason="no cyclonedds package for this machine, so no other listeners")


def test_two_minutes_beside_a_vehicle_stay_within_wide_margins_of_the_targets(bin_dir, source_dir, dds_domain):
    done = subprocess.run([sys.executable, source_dir / "tests/bench/footprint", "--minutes", "2", "--margin", "2",
                           "--no-packages", "--build", bin_dir.parent, "--domain", str(dds_domain)],
                          capture_output=True, text=True, timeout=500, check=False)
    print(done.stdout)
    assert done.returncode == 0, done.stdout + done.stderr
