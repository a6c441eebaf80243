"""Every code that calibd and its tools may say has its place in systemd/codes.txt, with cause, example and remedy."""

import re

import pytest

PARTS = ("cause", "example", "remedy")
# Words in the findings' sources that are no codes: names of checks, and of what may be wrong.
NO_CODES = {"image_size", "cloud_range", "camera_info", "right_camera_info", "right_image", "depth_topic", "not_checked"}


@pytest.fixture(scope="module")
def pages(source_dir):
    """Parts of each code."""
    text = (source_dir / "systemd/codes.txt").read_text()
    found = {}
    for block in re.split(r"\n\n+", text):
        if heading := re.match(r"\[([a-z_:]+)\]\n", block):
            assert heading[1] not in found, f"{heading[1]} is there twice"
            found[heading[1]] = dict(line.split(": ", 1) for line in block.splitlines()[1:])
    return found


def codes_of_errors(source_dir):
    header = (source_dir / "libcalib/include/calib/error_code.hpp").read_text()
    table = re.search(r"#define CALIB_ERROR_CODES(.*?)// clang-format on", header, re.DOTALL)[1]
    return {("malformed:" if kind == "MALFORMED" else "") + name for kind, name in re.findall(r"\b(CODE|MALFORMED)\((\w+)\)", table)}


def codes_of_findings(source_dir):
    words = set()
    for path in (source_dir / "daemon").glob("findings_*.cpp"):
        text = re.sub(r"//[^\n]*", "", path.read_text())
        words |= set(re.findall(r'"([a-z]+(?:_[a-z]+)+)"', text)) - NO_CODES
        words |= set(re.findall(r'problem\(\s*[^",]+,\s*"([a-z]+)"', text))
    readings = (source_dir / "libcalib/src/extrinsic_check.cpp").read_text()
    named = re.findall(r'\{"([a-z]+(?:_[a-z]+)*)",', readings)
    assert len(named) >= 5
    return words | {"extrinsic_" + name for name in named}


def codes_of_doubts(source_dir):
    return set(re.findall(r'string_view \w+ = "(\w+)";', (source_dir / "tools/calib_eval/doubts.hpp").read_text()))


def test_every_code_is_explained_and_no_other(source_dir, pages):
    said = codes_of_errors(source_dir) | codes_of_findings(source_dir) | codes_of_doubts(source_dir)
    assert len(codes_of_errors(source_dir)) > 140 and len(codes_of_findings(source_dir)) > 20 and len(codes_of_doubts(source_dir)) > 8
    assert not said - set(pages), "explain these in systemd/codes.txt"
    assert not set(pages) - said, "nothing says these any more"


def test_every_explanation_is_whole(pages):
    for code, parts in pages.items():
        assert tuple(parts) == PARTS, code
        assert all(parts.values()), code
        assert not parts["cause"].endswith(".") and not parts["remedy"].endswith("."), f"{code}: a full stop is added"
