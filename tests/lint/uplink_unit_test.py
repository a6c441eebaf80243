"""calib-uplink's unit, what is installed for it, and what its program needs."""

import re
import shutil
import subprocess

import pytest

MOST_EXPOSED = 1.1  # of systemd-analyze's scale of 10; the unit's opening comment says what keeps it above 0


def run(*command, **options):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)


@pytest.fixture(scope="module")
def unit(bin_dir, tmp_path_factory):
    """The unit as installed, its program being the one just built."""
    if not shutil.which("systemd-analyze"):
        pytest.skip("systemd-analyze is not installed")
    text = (bin_dir.parent / "systemd/calib-uplink.service").read_text()
    path = tmp_path_factory.mktemp("unit") / "calib-uplink.service"
    path.write_text(re.sub(r"^ExecStart=\S+", f"ExecStart={bin_dir}/calib-uplink", text, flags=re.MULTILINE))
    return path


def test_unit_says_nothing_that_systemd_does_not_know(unit):
    result = run("systemd-analyze", "verify", "--recursive-errors=no", "--man=no", unit)
    assert result.returncode == 0 and "calib-uplink" not in result.stderr, result.stderr


def test_unit_exposes_little(unit):
    result = run("systemd-analyze", "security", "--offline=yes", "--no-pager", f"--threshold={int(MOST_EXPOSED * 10)}", unit)
    assert result.returncode == 0, result.stdout + result.stderr


def test_unit_has_neither_the_signing_key_nor_the_rights_of_calibd(unit, source_dir):
    text = unit.read_text()
    assert "LoadCredential" not in text
    for line in ("User=calib-uplink", "Group=calib-uplink", "SupplementaryGroups=calibd", "RestartPreventExitStatus=78"):
        assert f"\n{line}\n" in text
    assert "/var/lib/calibd" in re.search("^InaccessiblePaths=(.*)$", text, re.MULTILINE).group(1)
    # Not a member of the group: a member may change what calibd does.
    assert not re.search(r"^m ", (source_dir / "systemd/calib-uplink.sysusers").read_text(), re.MULTILINE)


def test_program_loads_neither_dds_nor_an_estimator(bin_dir):
    libraries = run("ldd", bin_dir / "calib-uplink").stdout
    assert "libmosquitto" in libraries
    assert not re.search("libddsc|opencv|onnx|libsodium|sqlite", libraries), libraries


def test_installed_files_are_a_component_of_their_own(bin_dir, tmp_path):
    result = run("cmake", "--install", bin_dir.parent, "--component", "calibd-uplink",
                 env={"DESTDIR": str(tmp_path), "PATH": "/usr/bin:/bin"})
    assert result.returncode == 0, result.stderr
    found = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert found >= {"etc/calibd/uplink.yaml", "usr/sbin/calib-uplink", "usr/lib/systemd/system/calib-uplink.service",
                     "usr/lib/sysusers.d/calib-uplink.conf", "usr/lib/tmpfiles.d/calib-uplink.conf",
                     "usr/share/doc/calibd/feed.md"}
    assert "usr/sbin/calibd" not in found
