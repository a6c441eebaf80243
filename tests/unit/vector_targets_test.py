"""Every set of vector instructions gives the same pixels, counts and sums: those of this processor, and those of an
Arm processor (NEON), which QEMU stands in for."""

import platform
import shutil
import subprocess

import pytest

ARM_COMPILER, ARM = "aarch64-linux-gnu-g++", "qemu-aarch64"


def lines_of(*command):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout.splitlines()


def by_target(lines):
    """What each target printed: its name stands in a line of its own, results follow in lines with a colon."""
    results = {}
    for line in lines:
        if ":" in line:
            results[target].append(line)
        else:
            target = line
            results[target] = []
    return results


@pytest.fixture(scope="module")
def here(bin_dir):
    return by_target(lines_of(bin_dir / "tests/project_and_count"))


def test_the_targets_of_this_processor_agree(here):
    assert len(here) > 1
    some = next(iter(here.values()))
    assert len(some) == 4 and all(int(line.split()[1]) > 100 for line in some)
    assert all(result == some for result in here.values()), here


def test_neon_agrees_with_them(here, source_dir, tmp_path):
    missing = [program for program in (ARM_COMPILER, ARM) if shutil.which(program) is None]
    if missing or platform.machine() != "x86_64":
        pytest.skip(f"on {platform.machine()} without {' and '.join(missing) or 'need'}")
    eigen = lines_of("pkg-config", "--cflags-only-I", "eigen3")[0].removeprefix("-I").strip()
    program = tmp_path / "project_and_count"
    libcalib = source_dir / "libcalib"
    lines_of(ARM_COMPILER, "-std=c++20", "-O2", "-ffp-contract=off", "-march=armv8-a+crypto", "-DHWY_COMPILE_ONLY_STATIC",
             "-I", libcalib / "include", "-I", libcalib / "src", "-isystem", eigen, "-static",
             source_dir / "tests/support/project_and_count.cpp", libcalib / "src/joint_histogram.cpp", "-o", program)
    neon = by_target(lines_of(ARM, program))
    assert neon == {"NEON": next(iter(here.values()))}
