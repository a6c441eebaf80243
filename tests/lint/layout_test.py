"""The shape of the project: what lies at the top, how long files are, and what must not be written in them."""

import pathlib
import re
import subprocess

import pytest

TOP = {"CMakeLists.txt", "README.md", "libcalib", "proto", "daemon", "tools", "systemd", "tests"}
LONGEST = 400
CODE = {".cpp", ".hpp", ".c", ".h", ".py"}
SCRIPTS = {"setup", "test", "demo", "run"}
# Paths that exist on one person's machine only.
MACHINE_PATH = re.compile(r"(?<![\w.$}])/(work|home|root|Users|tmp/w)/")


@pytest.fixture(scope="module")
def tracked(source_dir):
    listing = subprocess.run(["git", "-C", source_dir, "ls-files", "-z"], capture_output=True, check=False)
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    paths = [source_dir / name for name in listing.stdout.decode().split("\0") if name]
    return [path for path in paths if path.is_file()]


def text_of(path):
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError:
        return ""


def test_top_level_holds_only_the_rooms(source_dir, tracked):
    top = {path.relative_to(source_dir).parts[0] for path in tracked}
    assert not {name for name in top if not name.startswith(".")} - TOP


def test_no_file_of_code_is_too_long(source_dir, tracked):
    lengths = {str(path.relative_to(source_dir)): len(text_of(path).splitlines())
               for path in tracked if path.suffix in CODE or path.name in SCRIPTS}
    assert lengths
    assert not {path: lines for path, lines in lengths.items() if lines > LONGEST}


def test_no_path_of_one_machine(source_dir, tracked):
    found = [f"{path.relative_to(source_dir)}: {match.group(0)}" for path in tracked
             if path != pathlib.Path(__file__).resolve() for match in MACHINE_PATH.finditer(text_of(path))]
    assert not found


def test_every_listed_source_exists_and_every_source_is_listed(source_dir, tracked):
    """CMake files list sources by name, so a file that none of them names is dead."""
    listings = "\n".join(text_of(path) for path in tracked if path.name == "CMakeLists.txt")
    unlisted = [str(path.relative_to(source_dir)) for path in tracked
                if path.suffix in {".cpp", ".c"} and not re.search(rf"\b{re.escape(path.name)}", listings)]
    assert not unlisted


def test_scripts_can_be_run(source_dir, tracked):
    scripts = [path for path in tracked if text_of(path).startswith("#!")]
    assert scripts
    assert not [str(path.relative_to(source_dir)) for path in scripts if not path.stat().st_mode & 0o100]
