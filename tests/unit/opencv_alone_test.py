"""calibd has the parts of OpenCV that it uses in itself: they compute what the shared libraries do, which tests and tools
have, and nothing that came with those is loaded."""

import re
import subprocess

import pytest


def output(*command):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=True).stdout


@pytest.fixture(scope="module")
def alone(bin_dir):
    program = bin_dir / "tests/opencv_results_alone"
    if not program.exists():
        pytest.skip("OpenCV's archives are not there, or are not used")
    return program


def test_results_are_those_of_the_shared_libraries(bin_dir, alone):
    results = output(alone).splitlines()
    assert len(results) > 30 and len({line.split()[-1] for line in results}) > 30
    assert results == output(bin_dir / "tests/opencv_results").splitlines()


def test_calibd_loads_no_opencv_and_nothing_of_what_it_needs(bin_dir, alone):
    assert "libopencv_core" in output("ldd", bin_dir / "tests/opencv_results")
    for program in (alone, bin_dir / "calibd"):
        loaded = output("ldd", program)
        assert "libc.so" in loaded
        assert not re.findall(r"lib(?:opencv|GL|X11|tbb|lapack|blas|gfortran)\w*", loaded)
