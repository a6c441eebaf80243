"""Sources compare the code of an error with an enumerator, never with its word, and never by the word's beginning."""

import re

import pytest

ROOMS = ("libcalib", "daemon", "tools")
COMMENT = re.compile(r"//[^\n]*|/\*.*?\*/", re.DOTALL)
CODE = r"\bcode(?:\(\)|_)?\)?"
BY_WORD = re.compile(rf"""{CODE}\s*[!=]=\s*"|"\s*[!=]=\s*[\w.()>-]*{CODE}|{CODE}\s*\.(?:starts_with|ends_with|find|compare|substr)\(""")


def comparisons_by_word(text):
    return [match.group(0) for match in BY_WORD.finditer(COMMENT.sub("", text))]


def test_no_source_compares_a_code_with_a_word(source_dir):
    found = {}
    for room in ROOMS:
        files = [path for path in (source_dir / room).rglob("*") if path.suffix in {".hpp", ".cpp"}]
        assert files
        for path in files:
            if by_word := comparisons_by_word(path.read_text()):
                found[str(path.relative_to(source_dir))] = by_word
    assert not found


@pytest.mark.parametrize("text", [
    'if (error.code == "low_overlap") return;', 'if (made.error().code != "denied")', 'failure->code == "store_moved"',
    'return code.starts_with("malformed:");', 'return to_string(error.code) == "not_ready";',
    'return "not_ready" == error.code;', 'error.code.find("depth")'])
def test_a_comparison_is_found(text):
    assert comparisons_by_word(text)


@pytest.mark.parametrize("text", [
    "if (error.code == ErrorCode::low_overlap) return;", '// code == "low_overlap"', 'if (encoding == "mono8") return;',
    'reply["code"].get<std::string>()'])
def test_other_code_is_let_be(text):
    assert not comparisons_by_word(text)


def test_every_code_of_the_table_is_used(source_dir):
    header = source_dir / "libcalib/include/calib/error_code.hpp"
    table = re.search(r"#define CALIB_ERROR_CODES(.*?)// clang-format on", header.read_text(), re.DOTALL).group(1)
    codes = [("malformed_" if kind == "MALFORMED" else "") + name
             for kind, name in re.findall(r"\b(CODE|MALFORMED)\((\w+)\)", table)]
    assert len(codes) > 100
    text = "\n".join(path.read_text() for room in ROOMS for path in (source_dir / room).rglob("*.[hc]pp") if path != header)
    assert not [code for code in codes if not re.search(rf"ErrorCode::{code}\b", text)]
