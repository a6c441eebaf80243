"""Fixtures for the tests of whole programs, and a skip that ctest can see."""

import os
import pathlib

import pytest

EXIT_SKIPPED = 77


@pytest.fixture(scope="session")
def bin_dir():
    """Folder of the programs under test."""
    return pathlib.Path(os.environ["CALIBD_BIN_DIR"])


@pytest.fixture(scope="session")
def source_dir():
    """The project's top folder."""
    return pathlib.Path(os.environ["CALIBD_SOURCE_DIR"])


@pytest.fixture(scope="session")
def dds_domain():
    """A DDS domain that no other test uses."""
    return int(os.environ["CALIBD_TEST_DOMAIN"])


@pytest.fixture(scope="session")
def slowdown():
    """What a time limit is multiplied by: sanitizers make programs some times slower."""
    return int(os.environ.get("CALIBD_TEST_SLOWDOWN", "1"))


@pytest.fixture(scope="session")
def kitti_drive():
    """The recorded drive, a KITTI raw <date>/<drive> folder; the test is skipped, visibly, without it."""
    drive = os.environ.get("CALIB_KITTI_DRIVE")
    if not drive:
        pytest.skip("no recorded drive: set CALIB_KITTI_DRIVE")
    assert os.path.isdir(drive), f"CALIB_KITTI_DRIVE names no folder: {drive}"
    return pathlib.Path(drive)


def pytest_terminal_summary(terminalreporter):
    for report in terminalreporter.stats.get("skipped", []):
        reason = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
        terminalreporter.write_line(f"SKIPPED: {reason.removeprefix('Skipped: ')} ({report.nodeid})")


def pytest_sessionfinish(session, exitstatus):
    """Exit with 77 when every test was skipped: ctest shows that as Skipped."""
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    ran = any(reporter.stats.get(outcome) for outcome in ("passed", "failed", "error", "xfailed", "xpassed"))
    if exitstatus == 0 and not ran and reporter.stats.get("skipped"):
        session.exitstatus = EXIT_SKIPPED
