"""Who may include and link whom. The order of libcalib's headers is the order in which data walks through it."""

import pathlib
import re

import pytest

ORDER = ("error_code result file image_header image_bits image_codec sha256 config_node wall_time geometry config_transform axis_words camera_models camera frame cloud_layout pairing depth_model depth depth_agreement extrinsic_check overlay "
         "quality features mutual_information cusum search recalibrate misalignment drift signature record chain store claim json_integer status formats").split()
# Implementations of an interface, and private parts, stand beside the header that they serve.
BESIDE = {"boundary": "camera_models", "camera_brown": "camera_models", "camera_equidistant": "camera_models", "camera_spheres": "camera_models", "drift_evidence": "drift", "drift_estimate": "drift", "depth_stereo": "depth", "stereo_rectification": "depth", "depth_topic": "depth", "depth_onnx": "depth", "depth_onnx_absent": "depth",
          "model_file": "depth_model", "network_image": "depth", "onnx_network": "depth",
          "joint_histogram": "mutual_information", "ranks": "features", "edges": "features", "cull": "features", "rotation_grid": "search", "search_steps": "search", "quadratic_model": "search",
          "uncertainty": "search", "recalibration_gates": "recalibrate", "opencv_alone": "depth", "opencv_alone_check": "depth",
          "json_fields": "record", "record_signature": "record", "sqlite_statement": "store", "store_outbox": "store"}

FOREIGN = re.compile(r"^(dds/|cyclonedds|spdlog/|systemd/|CLI/|mosquitto)")
NOT_PURE = {"iostream", "print", "thread", "mutex", "condition_variable", "future", "atomic",
            "pthread.h", "ctime", "time.h", "sys/time.h"}
NOT_PURE_CALLS = re.compile(r"\b(getenv|setenv|system_clock|steady_clock|high_resolution_clock|clock_gettime|"
                            r"std::jthread|std::thread|std::async|printf|fprintf|puts|omp_\w+)\b|#pragma omp")

INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)


def sources(folder):
    return sorted(path for path in folder.rglob("*") if path.suffix in {".hpp", ".cpp", ".h", ".c"})


def without_comments(text):
    return re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.DOTALL)


def place(stem):
    """Where a file of libcalib stands; none when the table above does not know it."""
    noun = BESIDE.get(stem, stem)
    return ORDER.index(noun) if noun in ORDER else None


def violations_in_libcalib(path, text):
    """What a file of libcalib does that it may not, as sentences."""
    code = without_comments(text)
    includes = INCLUDE.findall(code)
    found = [f"includes <{name}>" for name in includes if FOREIGN.match(name) or name in NOT_PURE]
    found += [f"uses {match.group(0)}" for match in NOT_PURE_CALLS.finditer(code)]
    if place(path.stem) is None:
        return found + [f"{path.stem} is not in the table of libcalib's files: add it to ORDER or BESIDE"]
    for name in includes:
        other = pathlib.PurePath(name)
        if other.suffix == ".hpp" and str(other.parent) in {"calib", "."} and (place(other.stem) or 0) > place(path.stem):
            found.append(f"includes {name}, which comes after {path.stem}")
    return found


def test_libcalib_is_pure_and_in_order(source_dir):
    files = sources(source_dir / "libcalib")
    assert files
    found = {str(path.relative_to(source_dir)): violations_in_libcalib(path, path.read_text()) for path in files}
    assert not {path: why for path, why in found.items() if why}


@pytest.mark.parametrize("text", [
    '#include "dds/dds.h"', "#include <spdlog/spdlog.h>", "# include <systemd/sd-daemon.h>", "#include <iostream>",
    "#include <thread>", "auto t = std::chrono::steady_clock::now();", 'const char* x = std::getenv("X");',
    '#include "calib/drift.hpp"', "#pragma omp parallel for"])
def test_a_violation_is_found(text):
    assert violations_in_libcalib(pathlib.Path("camera.cpp"), "#include <vector>\n" + text + "\n")


def test_a_comment_is_no_violation():
    assert not violations_in_libcalib(pathlib.Path("camera.cpp"), "// getenv and <iostream> are not for us\n")


def test_rooms_include_only_downwards(source_dir):
    found = []
    for room, forbidden in {"libcalib": r"daemon|tools|support", "tools": r"daemon/(?!dds/)|support",
                            "daemon": r"tools|support"}.items():
        for path in sources(source_dir / room):
            for name in INCLUDE.findall(without_comments(path.read_text())):
                if re.match(rf"(\.\./)*({forbidden})/", name):
                    found.append(f"{path.relative_to(source_dir)} includes {name}")
    assert not found


def linked_by(source_dir, target):
    """Names that CMake files hand to target_link_libraries(target ...), over the whole project."""
    linked = set()
    for listing in source_dir.glob("*/CMakeLists.txt"):
        text = re.sub(r"#[^\n]*", "", listing.read_text())
        for call in re.finditer(rf"target_link_libraries\(\s*{re.escape(target)}\s+([^)]*)\)", text):
            linked.update(call.group(1).split())
    return linked - {"PUBLIC", "PRIVATE", "INTERFACE"}


def test_calibctl_links_no_estimator(source_dir):
    reached, waiting = set(), ["calibctl"]
    while waiting:
        target = waiting.pop()
        for name in linked_by(source_dir, target) - reached:
            reached.add(name)
            waiting.append(name)
    assert "calib_record" in reached, "calibctl links no record library: has its target been renamed?"
    assert not {name for name in reached if name == "calib" or re.match(r"opencv|NLopt|onnx|CycloneDDS", name)}
