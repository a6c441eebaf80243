"""That `footprint` says miss to a miss, and no number where nothing was measured."""

import importlib.machinery
import importlib.util
import pathlib
import subprocess
import sys

import pytest

PROGRAM = pathlib.Path(__file__).with_name("footprint")


@pytest.fixture(scope="module")
def footprint():
    sys.path.insert(0, str(PROGRAM.parent))
    loader = importlib.machinery.SourceFileLoader("footprint", str(PROGRAM))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("footprint", loader))
    sys.modules["footprint"] = module  # dataclasses look their module up
    loader.exec_module(module)
    return module


def table(footprint, capsys, *figures, margin=1):
    code = footprint.report(figures, margin)
    return code, capsys.readouterr().out


@pytest.mark.parametrize("measured, code, word", [(59.9, 0, "ok"), (60, 0, "ok"), (60.1, 1, "MISS")])
def test_a_figure_above_its_target_is_a_miss_and_fails(footprint, capsys, measured, code, word):
    met = footprint.Figure("start", 0.1, "s", 0.3)
    ended, shown = table(footprint, capsys, met, footprint.Figure("memory", measured, "MB", 60), met)
    assert ended == code
    assert [line.split("|")[3].strip() for line in shown.splitlines() if line.startswith("memory")] == [word]


def test_a_margin_multiplies_the_targets_and_is_shown(footprint, capsys):
    memory = footprint.Figure("memory", 119, "MB", 60)
    assert table(footprint, capsys, memory)[0] == 1
    code, shown = table(footprint, capsys, memory, margin=2)
    assert code == 0 and "120 MB" in shown
    assert table(footprint, capsys, memory, margin=1.9)[0] == 1
    start = footprint.starting([1.1])
    assert table(footprint, capsys, start, margin=2)[0] == 0 and table(footprint, capsys, start, margin=1.9)[0] == 1


def test_nothing_measured_shows_no_number_and_is_not_ok(footprint, capsys):
    code, shown = table(footprint, capsys, footprint.Figure("disk", None, "MB/h", 1, "takes 300 s"))
    assert code == 0 and "not measured" in shown and "ok" not in shown and "takes 300 s" in shown


def test_a_figure_without_a_target_never_misses(footprint, capsys):
    code, shown = table(footprint, capsys, footprint.Figure("wake-ups", 1e6, "1/s"))
    assert code == 0 and "MISS" not in shown and "ok" not in shown


def test_each_miss_of_what_was_counted_is_found(footprint):
    memory = {"VmRSS": 60e6, "RssAnon": 40e6, "RssFile": 20e6, "VmHWM": 70e6}
    seen = footprint.Watch(seconds=600, pairs=60, cpu_s=5.9, switches=600, written=0, rss=memory)
    assert not footprint.processor_time(seen).missed() and not footprint.memory_watching(seen, network=False).missed()
    seen.cpu_s, seen.rss["VmRSS"] = 6.1, 80e6
    assert footprint.processor_time(seen).missed() and footprint.memory_watching(seen, network=False).missed()
    assert not footprint.memory_watching(seen, network=True).missed()
    assert footprint.wake_ups(seen).measured == 1
    assert footprint.starting([0.1, 0.31, 0.4]).missed() and not footprint.starting([0.1, 0.29, 0.4]).missed()
    assert footprint.stopping([0.2]).missed()


def test_packages_are_counted_with_what_they_depend_on_but_not_twice(footprint):
    known = {name: {"required": False, "kB": 1, "depends": depends} for name, depends in {
        "a": [["b"], ["gone", "c"]], "b": [["c"], ["a"]], "c": [], "d": []}.items()}
    assert footprint.debian_packages.closure(["a"], known) == {"a", "b", "c"}


def test_what_cannot_be_measured_ends_with_2(tmp_path):
    for build in (tmp_path, tmp_path / "none"):
        done = subprocess.run([sys.executable, PROGRAM, "--build", build], capture_output=True, text=True, timeout=60)
        assert done.returncode == 2 and "build first" in done.stderr and not done.stdout.count("ok")
