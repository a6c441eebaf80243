"""Sources include what they use. Precompiled headers would hide that a source does not: so here names are looked up, and
each public header is compiled by itself."""

import concurrent.futures
import functools
import os
import re
import subprocess

import pytest
from compile_flags import all_flags

# Names of the standard library by the header that declares them; more than one header where each is certain to.
PROVIDED = {
    "algorithm": "ranges::\\w+ min max clamp sort stable_sort nth_element min_element max_element minmax_element find find_if "
                 "any_of all_of none_of count_if copy_n copy_if transform fill fill_n reverse rotate unique lower_bound "
                 "upper_bound equal remove_if partial_sort is_sorted equal_range",
    "array": "array to_array",
    "atomic": "atomic atomic_flag memory_order_\\w+",
    "charconv": "from_chars to_chars",
    "chrono": "chrono::\\w+ chrono_literals",
    "cmath": "sqrt sin cos tan asin acos atan atan2 hypot floor ceil lround llround isfinite isnan isinf exp log log2 log10 pow "
             "fmod remainder cbrt erfc erf copysign nextafter",
    "condition_variable": "condition_variable condition_variable_any",
    "cstdint": "u?int(8|16|32|64)_t",
    "cstring": "memcpy memcmp memset memmove strlen strcmp strerror",
    "deque": "deque",
    "filesystem": "filesystem filesystem::\\w+",
    "fstream": "ifstream ofstream",
    "functional": "function ref cref plus greater less",
    "future": "future promise async",
    "iostream": "cout cerr clog cin",
    "map": "map multimap",
    "memory": "unique_ptr shared_ptr weak_ptr make_unique make_shared",
    "mutex": "mutex lock_guard unique_lock scoped_lock",
    "numbers": "numbers::\\w+",
    "numeric": "accumulate iota inner_product reduce midpoint gcd",
    "optional": "optional nullopt make_optional",
    "random": "mt19937 mt19937_64 normal_distribution uniform_int_distribution uniform_real_distribution random_device",
    "regex": "regex smatch regex_match regex_search",
    "set": "set",
    "span": "span",
    "sstream": "ostringstream istringstream stringstream",
    "stdexcept": "runtime_error invalid_argument out_of_range logic_error",
    "string": "string to_string stoi stod stoul getline",
    "string_view": "string_view",
    "thread": "thread jthread this_thread::\\w+",
    "tuple": "tuple tie make_tuple apply",
    "variant": "variant holds_alternative get_if visit monostate",
    "vector": "vector",
}
ALSO = {"string_view": {"string"}, "string": {"filesystem", "sstream"}}
OTHERS = {r"\bcv::": "opencv2/", r"\bnlohmann::": "nlohmann/", r"\bEigen::": "Eigen/", r"\bfmt::": "fmt/",
          r"\bspdlog::": "spdlog/", r"\btl::": "tl/"}
USED = {header: re.compile(rf"\bstd::({'|'.join(names.split())})\b") for header, names in PROVIDED.items()}
USED_OTHERS = {re.compile(name): folder for name, folder in OTHERS.items()}
INCLUDE = re.compile(r'^\s*#\s*include\s*[<"]([^>"]+)[>"]', re.MULTILINE)
ROOMS = ("libcalib", "daemon", "tools", "tests")


def code_of(text):
    """Without comments, and without what stands between quotes, except on the lines that include."""
    text = re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.DOTALL)
    return re.sub(r'^(?!\s*#).*$', lambda line: re.sub(r'"(\\.|[^"\\\n])*"', '""', line.group(0)), text, flags=re.MULTILINE)


class Includes:
    """What a file includes, itself and through the project's own headers."""

    def __init__(self, source_dir):
        self.folders = [source_dir / name for name in ("libcalib/include", "libcalib/src", "daemon", "tools", "tools/calibctl",
                                                       "tools/calib_eval", "tests")]

    @functools.lru_cache(maxsize=None)
    def of(self, path):
        found = set()
        for name in INCLUDE.findall(code_of(path.read_text())):
            own = next((folder / name for folder in (path.parent, *self.folders) if (folder / name).is_file()), None)
            found |= self.of(own) if own else {name}
        return frozenset(found)


def missing(code, included):
    """Headers that a file uses names of without including them, each with the first such name."""
    found = []
    for header, used in USED.items():
        if (use := used.search(code)) and not included & {header, *ALSO.get(header, ())}:
            found.append(f"std::{use.group(1)} without <{header}>")
    for used, folder in USED_OTHERS.items():
        if (use := used.search(code)) and not any(name.startswith(folder) for name in included):
            found.append(f"{use.group(0)} without <{folder}...>")
    return found


def test_what_is_used_is_included(source_dir):
    includes = Includes(source_dir)
    files = [path for room in ROOMS for path in sorted((source_dir / room).rglob("*.[ch]pp"))]
    assert files
    found = {str(path.relative_to(source_dir)): missing(code_of(path.read_text()), includes.of(path)) for path in files}
    assert not {path: what for path, what in found.items() if what}


@pytest.mark.parametrize("text", ["std::vector<int> v;", "int x = std::max(1, 2);", "std::filesystem::path p;", "cv::Mat m;",
                                  "std::chrono::seconds s;", "auto x = std::ranges::find(v, 1);", "std::uint8_t byte;"])
def test_a_missing_include_is_found(text):
    assert missing(text, frozenset({"optional"}))


def test_comments_and_words_in_quotes_use_nothing():
    text = code_of('// std::vector\n#include <optional>\nauto text = "std::map";\n')
    assert not missing(text, frozenset({"optional"}))
    assert INCLUDE.findall(text) == ["optional"]


def test_a_public_header_compiles_by_itself(source_dir, bin_dir, tmp_path):
    compiler, flags = all_flags(bin_dir)[str(source_dir / "libcalib/src/camera.cpp")]
    command = [compiler, *flags, "-fsyntax-only", "-Wall", "-Wextra", "-Werror", "-x", "c++"]
    headers = sorted((source_dir / "libcalib/include/calib").glob("*.hpp"))
    assert headers

    def error_of(header):
        source = tmp_path / f"{header.stem}.cpp"
        source.write_text(f'#include "calib/{header.name}"\n#include "calib/{header.name}"\n')
        return subprocess.run([*command, source], capture_output=True, text=True, check=False).stderr

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as threads:
        errors = dict(zip((header.name for header in headers), threads.map(error_of, headers)))
    assert not {name: error for name, error in errors.items() if error}
