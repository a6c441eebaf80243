"""The unit, the journal catalog and what is installed with them."""

import os
import re
import shutil
import subprocess
import sys

import pytest

MOST_EXPOSED = 1.2  # of systemd-analyze's scale of 10; the unit's opening comment says what keeps it above 0


def run(*command, **options):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)


@pytest.fixture(scope="module")
def unit(bin_dir, tmp_path_factory):
    """The unit as installed, its program being the one just built."""
    text = (bin_dir.parent / "systemd/calibd.service").read_text()
    path = tmp_path_factory.mktemp("unit") / "calibd.service"
    path.write_text(re.sub(r"^(ExecStart|ExecReload)=\S*/(\w+)", rf"\1={bin_dir}/\2", text, flags=re.MULTILINE))
    return path


@pytest.fixture(scope="module")
def systemd_analyze():
    if not shutil.which("systemd-analyze"):
        pytest.skip("systemd-analyze is not installed")


def test_unit_says_nothing_that_systemd_does_not_know(systemd_analyze, unit):
    result = run("systemd-analyze", "verify", "--recursive-errors=no", "--man=no", unit)
    about_it = [line for line in result.stderr.splitlines() if "calibd" in line]
    assert result.returncode == 0 and not about_it, result.stderr


def test_unit_exposes_little(systemd_analyze, unit):
    result = run("systemd-analyze", "security", "--offline=yes", "--no-pager", f"--threshold={int(MOST_EXPOSED * 10)}", unit)
    assert result.returncode == 0, result.stdout + result.stderr


def test_unit_keeps_what_the_daemon_counts_on(unit):
    text = unit.read_text()
    for line in ("Type=notify", "RestartPreventExitStatus=78 243", "RuntimeDirectoryPreserve=yes", "User=calibd",
                 "LoadCredential=signing.key:/etc/calibd/signing.key",
                 "SetCredential=signing.key:missing:/etc/calibd/signing.key", "LimitCORE=0"):
        assert f"\n{line}\n" in text
    assert re.search(r"^ExecReload=\S+/calibctl reload$", text, re.MULTILINE)
    assert re.search(r"^WatchdogSec=\d+s$", text, re.MULTILINE)


def test_networks_run_where_no_memory_may_become_code(bin_dir):
    """The kernel's own form of MemoryDenyWriteExecute=, which is inherited."""
    refuse = ("import ctypes, os, sys\n"
              "refused = ctypes.CDLL(None).prctl(65, 1, 0, 0, 0)\n"  # PR_SET_MDWE, PR_MDWE_REFUSE_EXEC_GAIN
              "os.execv(sys.argv[1], sys.argv[1:]) if refused == 0 else sys.exit(77)\n")
    result = run(sys.executable, "-c", refuse, bin_dir / "tests/libcalib_tests", "-#", "[#depth_onnx_test]")
    if result.returncode == 77:
        pytest.skip("this kernel has no PR_SET_MDWE")
    assert result.returncode == 0, result.stdout + result.stderr


def test_catalog_explains_every_message_id_and_no_other(source_dir):
    declared = re.findall(r'string_view \w+ = "([0-9a-f]{32})"', (source_dir / "daemon/message_ids.hpp").read_text())
    explained = re.findall(r"^-- ([0-9a-f]{32})$", (source_dir / "systemd/calibd.catalog").read_text(), re.MULTILINE)
    assert declared and len(set(declared)) == len(declared)
    assert sorted(declared) == sorted(explained)


def test_catalog_is_read_by_journalctl(source_dir, tmp_path):
    if not shutil.which("journalctl"):
        pytest.skip("journalctl is not installed")
    folder = tmp_path / "usr/lib/systemd/catalog"
    folder.mkdir(parents=True)
    shutil.copy(source_dir / "systemd/calibd.catalog", folder)
    (tmp_path / "var/lib/systemd/catalog").mkdir(parents=True)
    result = run("journalctl", f"--root={tmp_path}", "--update-catalog")
    assert result.returncode == 0 and not result.stderr, result.stderr
    listed = run("journalctl", f"--root={tmp_path}", "--list-catalog").stdout
    assert len(re.findall("^[0-9a-f]{32} calibd: ", listed, re.MULTILINE)) == 25


def test_declared_ids_are_the_logged_ones(source_dir):
    declared = set(re.findall(r"string_view (\w+) =", (source_dir / "daemon/message_ids.hpp").read_text()))
    used = {name for path in (source_dir / "daemon").glob("*.cpp")
            for name in re.findall(r"message_ids::(\w+)", path.read_text())}
    assert used == declared, "each declared and explained id is logged somewhere, and no other"


def test_installed_files_lie_where_the_system_looks(bin_dir, tmp_path):
    result = run("cmake", "--install", bin_dir.parent, env={"DESTDIR": str(tmp_path), "PATH": "/usr/bin:/bin"})
    assert result.returncode == 0, result.stderr
    for path in ("etc/calibd/calibd.yaml", "usr/sbin/calibd", "usr/bin/calibctl", "usr/lib/systemd/system/calibd.service",
                 "usr/lib/sysusers.d/calibd.conf", "usr/lib/tmpfiles.d/calibd.conf",
                 "usr/lib/systemd/system/calibd-receive-buffer.service", "usr/lib/systemd/catalog/calibd.catalog"):
        assert (tmp_path / path).is_file(), path
    wanted = tmp_path / "usr/lib/systemd/system/calibd.service.wants/calibd-receive-buffer.service"
    assert wanted.is_symlink() and wanted.resolve() == tmp_path / "usr/lib/systemd/system/calibd-receive-buffer.service"
    script = re.search(r"^ExecStart=(\S+)", wanted.read_text(), re.MULTILINE).group(1)
    assert os.access(tmp_path / script.removeprefix("/"), os.X_OK)


def test_units_say_nothing_that_systemd_does_not_know(systemd_analyze, bin_dir, source_dir, tmp_path):
    text = (bin_dir.parent / "systemd/calibd-receive-buffer.service").read_text()
    unit = tmp_path / "calibd-receive-buffer.service"
    unit.write_text(re.sub(r"(?<=^ExecStart=)\S+", str(source_dir / "systemd/raise-receive-buffer"), text, flags=re.MULTILINE))
    result = run("systemd-analyze", "verify", "--recursive-errors=no", "--man=no", unit)
    assert result.returncode == 0 and "calibd" not in result.stderr, result.stderr


@pytest.mark.parametrize("before, after", [(212992, 10485760), (10485760, 10485760), (33554432, 33554432)])
def test_the_limit_of_receive_buffers_is_raised_and_never_lowered(source_dir, tmp_path, before, after):
    limit = tmp_path / "rmem_max"
    limit.write_text(f"{before}\n")
    result = run(source_dir / "systemd/raise-receive-buffer", 10485760, limit)
    assert result.returncode == 0 and int(limit.read_text()) == after, result.stderr
