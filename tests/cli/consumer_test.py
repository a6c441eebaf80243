"""libcalib serves other projects: it is installed, found by CMake, and linked by a program that is not built with it."""

import os
import re
import shutil
import subprocess

import pytest


def run(*command, **options):
    result = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def prefix(bin_dir, tmp_path_factory):
    """Where the development files are installed; no other component is."""
    folder = tmp_path_factory.mktemp("prefix")
    run("cmake", "--install", bin_dir.parent, "--prefix", folder, "--component", "development")
    return folder


@pytest.fixture(scope="module")
def consumer(source_dir, prefix, tmp_path_factory):
    """The build folder of tests/consumer, taken to a place of its own, so that it cannot see calibd's sources."""
    project, build = tmp_path_factory.mktemp("consumer"), tmp_path_factory.mktemp("build")
    shutil.copytree(source_dir / "tests/consumer", project, dirs_exist_ok=True)
    environment = {**os.environ, "CCACHE_DISABLE": "1"}
    run("cmake", "-S", project, "-B", build, "-G", "Ninja", f"-DCMAKE_PREFIX_PATH={prefix}", env=environment)
    run("cmake", "--build", build, env=environment)
    return build


def test_only_headers_libraries_and_package_files_are_installed(prefix):
    installed = [str(path.relative_to(prefix)) for path in prefix.rglob("*") if path.is_file()]
    other = [path for path in installed
             if not re.fullmatch(r"include/calib/\w+\.hpp|lib/(.+/)?libcalib\w*\.a|lib/(.+/)?cmake/calib/calib[-_\w]+\.cmake", path)]
    assert installed and not other
    headers = [path for path in installed if path.endswith(".hpp")]
    assert {"include/calib/features.hpp", "include/calib/record.hpp"} <= set(headers)


def test_what_is_installed_names_no_folder_of_the_source(source_dir, bin_dir, prefix):
    texts = {path: path.read_text() for path in prefix.rglob("*.cmake")}
    assert texts and not [path for path, text in texts.items() if str(source_dir) in text or str(bin_dir.parent) in text]


def test_a_frame_scores_best_at_its_own_extrinsic(consumer):
    lines = dict(line.split(" ", 1) for line in run(consumer / "consumer").splitlines())
    score = float(lines["score"])
    assert int(lines["points"]) > 1000 and 1 < score <= 2
    for axis in ("roll", "pitch", "yaw"):
        minus, plus = map(float, lines[axis].split())
        assert minus < score and plus < score, axis


def test_the_record_library_links_without_the_estimator(consumer):
    assert re.fullmatch(r"key [0-9A-F]{16}\n", run(consumer / "key_id"))
    libraries = run("ldd", consumer / "key_id")
    assert "libsodium" in libraries and "opencv" not in libraries and "onnx" not in libraries
