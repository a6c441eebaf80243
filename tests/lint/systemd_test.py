"""The unit, the journal catalog and what is installed with them."""

import re
import shutil
import subprocess
import sys

import pytest

MOST_EXPOSED = 1.3  # of systemd-analyze's scale of 10; the unit's opening comment says what keeps it above 0


def run(*command, **options):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)


@pytest.fixture(scope="module")
def unit(bin_dir, tmp_path_factory):
    """The unit as installed, its program being the one just built."""
    text = (bin_dir.parent / "systemd/calibd.service").read_text()
    installed = re.search(r"^ExecStart=(\S+)", text, re.MULTILINE).group(1)
    path = tmp_path_factory.mktemp("unit") / "calibd.service"
    path.write_text(text.replace(installed, str(bin_dir / "calibd")))
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
    for line in ("Type=notify", "RestartPreventExitStatus=78", "RuntimeDirectoryPreserve=yes", "User=calibd",
                 "LoadCredential=signing.key:/etc/calibd/signing.key", "LimitCORE=0"):
        assert f"\n{line}\n" in text
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
    assert len(re.findall("^[0-9a-f]{32} calibd: ", listed, re.MULTILINE)) == 21


def test_declared_ids_are_the_logged_ones(source_dir):
    declared = set(re.findall(r"string_view (\w+) =", (source_dir / "daemon/message_ids.hpp").read_text()))
    used = {name for path in (source_dir / "daemon").glob("*.cpp")
            for name in re.findall(r"message_ids::(\w+)", path.read_text())}
    assert used == declared, "each declared and explained id is logged somewhere, and no other"


def test_installed_files_lie_where_the_system_looks(bin_dir, tmp_path):
    result = run("cmake", "--install", bin_dir.parent, env={"DESTDIR": str(tmp_path), "PATH": "/usr/bin:/bin"})
    assert result.returncode == 0, result.stderr
    for path in ("etc/calibd/calibd.yaml", "usr/sbin/calibd", "usr/bin/calibctl", "usr/lib/systemd/system/calibd.service",
                 "usr/lib/sysusers.d/calibd.conf", "usr/lib/tmpfiles.d/calibd.conf", "usr/lib/sysctl.d/60-calibd.conf",
                 "usr/lib/systemd/catalog/calibd.catalog"):
        assert (tmp_path / path).is_file(), path


def test_package_holds_what_is_installed(bin_dir, tmp_path):
    if not shutil.which("dpkg-shlibdeps"):
        pytest.skip("dpkg-shlibdeps (package dpkg-dev) is not installed")
    result = run("cpack", "-G", "DEB", "-B", tmp_path, cwd=bin_dir.parent)
    assert result.returncode == 0, result.stdout + result.stderr
    (package,) = tmp_path.glob("*.deb")
    fields = run("dpkg-deb", "-f", package).stdout
    assert re.search(r"^Package: calibd$", fields, re.MULTILINE)
    private = {library.name for library in (bin_dir.parent / "lib").rglob("calibd/*.so*")}
    for name, package_name in (("libddsc.so.0", "libddsc"), ("libonnxruntime.so.1", "libonnxruntime")):
        depends = re.search(rf"^Depends:.*\b{package_name}", fields, re.MULTILINE) is not None
        assert depends != (name in private), f"{name} comes either with the package or with another: {fields}"
    names = run("dpkg-deb", "-c", package).stdout
    for path in ("./etc/calibd/calibd.yaml", "./usr/sbin/calibd", "./usr/lib/systemd/system/calibd.service"):
        assert re.search(rf" {re.escape(path)}$", names, re.MULTILINE), names
    assert set(re.findall(r" \./usr/lib/.*/calibd/(\S+\.so\S*)$", names, re.MULTILINE)) == private
    notices = {"libddsc.so.0": "cyclonedds/NOTICE.md", "libonnxruntime.so.1": "onnxruntime/ThirdPartyNotices.txt"}
    for name in private:
        assert f"./usr/share/doc/calibd/{notices[name]}\n" in names, names
    assert "/tests/" not in names

    root = tmp_path / "unpacked"
    assert run("dpkg-deb", "-x", package, root).returncode == 0
    for program in ("usr/sbin/calibd", "usr/bin/calib-eval"):
        result = run(root / program, "--version", env={})
        assert result.returncode == 0, f"it needs what neither the package nor its dependencies bring: {result.stderr}"
        assert b"/opt/" not in (root / program).read_bytes(), "a library that only this machine has"
        found = run("ldd", root / program).stdout
        for name in private:
            assert name not in found or f"{name} => {root}/usr/" in found, found
