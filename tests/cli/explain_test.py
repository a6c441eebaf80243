"""calibctl explain, and the page of the manual that it writes."""

import re
import subprocess

import pytest

DONE, NOT_FOUND = 0, 3


@pytest.fixture(scope="module")
def explain(bin_dir):
    def run(*arguments):
        return subprocess.run([bin_dir / "calibctl", "explain", *arguments], capture_output=True, text=True, timeout=20)

    return run


@pytest.fixture(scope="module")
def codes(source_dir):
    return re.findall(r"^\[(.*)\]$", (source_dir / "systemd/codes.txt").read_text(), re.MULTILINE)


def test_a_code_is_explained_with_cause_example_and_remedy(explain):
    ended = explain("malformed:row_step")
    assert ended.returncode == DONE and ended.stderr == ""
    assert [line.split(":")[0].strip() for line in ended.stdout.splitlines() if line[0] != " "] == ["Code", "Cause", "Example", "Remedy"]
    assert "row_step is 0" in ended.stdout


def test_every_code_is_found_and_listed(explain, codes):
    listed = explain().stdout
    for code in codes:
        assert re.search(rf"\b{code}\b", listed), code
    for code in codes[::10]:
        assert explain(code).stdout.count("\n") >= 4, code


def test_a_code_that_does_not_exist_is_told_with_what_is_like_it(explain):
    ended = explain("frames")
    assert ended.returncode == NOT_FOUND and ended.stdout == ""
    assert "there is no code 'frames'; there is " in ended.stderr and "few_frames" in ended.stderr
    assert "calibctl explain lists all" in explain("zz\x1b[2J").stderr
    assert "\x1b" not in explain("zz\x1b[2J").stderr
    assert explain("cause: ").returncode == NOT_FOUND


def test_the_page_of_the_manual_has_every_code(explain, codes):
    page = explain("--page").stdout
    assert page.startswith("calibd-codes(7)\n")
    for code in codes:
        word = code.replace("_", "\\_")
        assert re.search(rf"^\*{re.escape(word)}\*\n\tCause: .+\n\n\tExample: .+\n\n\tRemedy: .+\n", page, re.MULTILINE), code
