"""C++ is formatted as .clang-format says. Mend it with: .venv/bin/clang-format -i FILE..."""

import concurrent.futures
import os
import subprocess

import pytest


def test_sources_are_formatted(source_dir):
    listing = subprocess.run(["git", "-C", source_dir, "ls-files", "*.cpp", "*.hpp"], capture_output=True, text=True, check=False)
    if listing.returncode != 0:
        pytest.skip("not a git checkout")
    files = [name for name in listing.stdout.split() if (source_dir / name).is_file()]
    assert files
    formatter = source_dir / ".venv/bin/clang-format"

    def differs(name):
        return subprocess.run([formatter, "--dry-run", "-Werror", name], cwd=source_dir, capture_output=True,
                              check=False).returncode != 0

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as threads:
        differing = [name for name, wrong in zip(files, threads.map(differs, files)) if wrong]
    assert not differing, "run .venv/bin/clang-format -i on these"
