"""The packages that `cpack -G DEB` makes: what is in each, what each needs, and that what they hold is complete."""

import gzip
import os
import re
import shutil
import subprocess
import sys

import pytest


def run(*command, **options):
    return subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)


def output(*command, **options):
    result = run(*command, **options)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def private(bin_dir):
    """Names of the libraries that are not the distribution's."""
    return {library.name for library in (bin_dir.parent / "lib").rglob("calibd/*.so*")}


@pytest.fixture(scope="module")
def packages(bin_dir, tmp_path_factory):
    """Each package's file by its name."""
    if not shutil.which("dpkg-shlibdeps"):
        pytest.skip("dpkg-shlibdeps (package dpkg-dev) is not installed")
    folder = tmp_path_factory.mktemp("packages")
    output("cpack", "-G", "DEB", "-B", folder, cwd=bin_dir.parent)
    return {output("dpkg-deb", "-f", file, "Package").strip(): file for file in folder.glob("*.deb")}


@pytest.fixture(scope="module")
def roots(packages, tmp_path_factory):
    """Each package, unpacked by itself."""
    found = {}
    for name, file in packages.items():
        found[name] = tmp_path_factory.mktemp(name)
        output("dpkg-deb", "-x", file, found[name])
    return found


@pytest.fixture(scope="module")
def whole(packages, tmp_path_factory):
    """All packages, as they are when they are installed."""
    root = tmp_path_factory.mktemp("whole")
    for file in packages.values():
        output("dpkg-deb", "-x", file, root)
    return root


def field(packages, name, key):
    return output("dpkg-deb", "-f", packages[name], key).strip()


def test_the_network_and_the_tools_are_packages_of_their_own(packages, roots):
    assert {"calibd", "calibd-onnx", "calibd-tools", "calibd-uplink"} <= set(packages)
    where = {program: {name for name, root in roots.items() if list(root.glob(f"usr/*bin/{program}"))}
             for program in ("calibd", "calibctl", "calib-uplink", "calib-eval", "calib-sim", "calib-replay", "calib-check-model")}
    assert where == {"calibd": {"calibd"}, "calibctl": {"calibd"}, "calib-uplink": {"calibd-uplink"}, "calib-eval": {"calibd-tools"},
                     "calib-sim": {"calibd-tools"}, "calib-replay": {"calibd-tools"}, "calib-check-model": {"calibd-tools"}}
    for path in ("etc/calibd/calibd.yaml", "usr/lib/systemd/system/calibd.service", "usr/share/man/man8/calibd.8.gz",
                 "usr/share/man/man5/calibd.yaml.5.gz", "usr/share/bash-completion/completions/calibctl",
                 "usr/share/zsh/vendor-completions/_calibctl", "usr/lib/systemd/catalog/calibd.catalog"):
        assert (roots["calibd"] / path).is_file(), path
    for path in ("etc/calibd/uplink.yaml", "usr/lib/systemd/system/calib-uplink.service", "usr/share/man/man8/calib-uplink.8.gz"):
        assert (roots["calibd-uplink"] / path).is_file(), path
    assert (roots["calibd-onnx"] / "usr/share/calibd/models/street-small.yaml").is_file()
    assert (roots["calibd-tools"] / "usr/share/calibd/calib-eval-plot").is_file()
    assert not [path for root in roots.values() for path in root.rglob("*") if "tests" in path.parts[-3:]]


def test_the_daemon_with_stereo_needs_neither_a_network_nor_opencv(bin_dir, packages):
    depends = field(packages, "calibd", "Depends")
    assert re.search(r"\blibc6\b", depends) and not re.search(r"onnx|protobuf|calibd-", depends)
    if (bin_dir / "tests/opencv_results_alone").exists():
        assert not re.search(r"opencv|lapack|tbb|libgl", depends), depends


def test_the_other_packages_need_the_daemon_of_their_own_version(packages):
    version = field(packages, "calibd", "Version")
    for name in set(packages) - {"calibd"}:
        assert f"calibd (= {version})" in field(packages, name, "Depends")


def test_libraries_that_the_distribution_lacks_come_with_their_notices(packages, roots, private):
    held = {name: {path.name for path in root.glob("usr/lib/*/calibd/*.so*")} for name, root in roots.items()}
    assert set().union(*held.values()) == private
    for library, name, package_name, notices in (
            ("libddsc.so.0", "calibd", "libddsc", "calibd/cyclonedds/NOTICE.md"),
            ("libonnxruntime.so.1", "calibd-onnx", "libonnxruntime", "calibd-onnx/onnxruntime/ThirdPartyNotices.txt")):
        depends = re.search(rf"\b{package_name}", field(packages, name, "Depends")) is not None
        assert depends != (library in held[name]), f"{library} comes either with the package or with another"
        assert library not in held[name] or (roots[name] / "usr/share/doc" / notices).is_file()


def test_programs_run_from_where_they_are_installed(whole, private):
    for program in ("usr/sbin/calibd", "usr/bin/calibctl", "usr/bin/calib-eval"):
        result = run(whole / program, "--version", env={})
        assert result.returncode == 0, f"it needs what neither the packages nor their dependencies bring: {result.stderr}"
        assert b"/opt/" not in (whole / program).read_bytes(), "a library that only this machine has"
        found = output("ldd", whole / program)
        for name in private:
            assert name not in found or f"{name} => {whole}/usr/" in found, found


def test_each_package_has_a_changelog_of_its_version_and_a_copyright(packages, roots):
    for name, root in roots.items():
        folder = root / "usr/share/doc" / name
        with gzip.open(folder / "changelog.Debian.gz", "rt") as changelog:
            assert changelog.readline().startswith(f"calibd ({field(packages, name, 'Version')}) ")
        assert (folder / "copyright").read_text().startswith("Format: https://www.debian.org/doc/packaging-manuals/")


def test_the_scripts_of_the_packages_are_shell_and_ask_systemd_only_where_it_runs(source_dir):
    for name in ("postinst", "prerm", "postrm", "uplink/postinst", "uplink/prerm", "uplink/postrm"):
        script = source_dir / "systemd/package" / name
        assert run("sh", "-n", script).returncode == 0 and os.access(script, os.X_OK)
        text = script.read_text()
        assert text.count("systemctl") == len(re.findall(r"systemctl .*\|\| true$", text, re.MULTILINE)), name


def test_lintian_finds_no_error(packages):
    if not shutil.which("lintian"):
        pytest.skip("lintian is not installed")
    # Of users: root may not be the one who checks.
    found = run("lintian", "--fail-on", "error", "--allow-root", *packages.values())
    assert found.returncode == 0, found.stdout + found.stderr


def commands_and_options(calibctl):
    """As its help prints them: each command with its options; without a command, the options before it."""
    top = output(calibctl, "--help")
    commands = re.findall(r"^  ([a-z][\w-]*) +\S", top.split("Subcommands:")[1], re.MULTILINE)
    assert {"status", "keygen"} <= set(commands)
    texts = {"": top, **{name: output(calibctl, name, "--help") for name in commands}}
    return {name: set(re.findall(r"(?:^  |,)(-[\w-]+)", text, re.MULTILINE)) for name, text in texts.items()}


def completed(bash_file, *words):
    """What bash offers after these words."""
    program = ('source "$1"; shift; COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); _calibctl; printf "%s\\n" "${COMPREPLY[@]}"')
    return set(output("bash", "-c", program, "bash", bash_file, "calibctl", *words).split())


def test_completion_offers_every_command_and_option_that_calibctl_has(bin_dir):
    folder, known = bin_dir.parent / "tools/completion", commands_and_options(bin_dir / "calibctl")
    zsh = (folder / "_calibctl").read_text()
    assert set(known) - {""} | known[""] <= completed(folder / "calibctl", "")
    for command, options in known.items():
        if not command:
            continue
        assert options <= completed(folder / "calibctl", command, "-"), command
        assert f"'{command}:" in zsh
        (line,) = [line for line in zsh.splitlines() if line.strip().startswith(f"{command}) _arguments")]
        assert options <= set(re.findall(r"'(-[\w-]+)", line)), command


def test_completion_offers_the_words_that_an_option_takes(bin_dir):
    assert completed(bin_dir.parent / "tools/completion/calibctl", "wait", "--for", "") == {
        "calibrated", "drifted", "not_evaluated", "any-change"}


def test_the_manual_of_the_configuration_has_its_keys_and_fits_a_terminal(source_dir):
    example = (source_dir / "systemd/calibd.yaml").read_text()
    page = output(sys.executable, source_dir / "systemd/manual_page.py", input=example)
    block = page.split("```")[1]
    for key in set(re.findall(r"^ *(?:# )?(?:- )?([a-z_]+): ", example, re.MULTILINE)):
        assert re.search(rf"\b{key}:", block), key
    assert not [line for line in block.splitlines() if len(line) > 80]
    words = re.findall(r"[\w.]+", re.sub(r"(?m)^ *# ?", " ", example))
    assert sorted(words) == sorted(re.findall(r"[\w.]+", re.sub(r"(?m)^ *# ?", " ", block)))
