"""Programs and the libraries they bring along, as ELF files: what the loader is told, and how they are hardened."""

import platform
import re
import subprocess

import pytest


def readelf(*arguments):
    return subprocess.run(["readelf", "--wide", *map(str, arguments)], capture_output=True, text=True, check=True).stdout


def is_elf(path):
    return path.is_file() and not path.is_symlink() and path.open("rb").read(4) == b"\x7fELF"


@pytest.fixture(scope="module")
def programs(bin_dir):
    """All that was built to be run, tests included."""
    found = [path for folder in (bin_dir, bin_dir / "tests") for path in sorted(folder.iterdir()) if is_elf(path)]
    assert {"calibd", "calibctl", "calib-eval", "calib-sim", "calib-replay"} <= {path.name for path in found}
    return found


@pytest.fixture(scope="module")
def private_libraries(bin_dir):
    """The libraries that are installed with calibd, as the build folder has them too."""
    return sorted((bin_dir.parent / "lib").rglob("calibd/*.so*"))


def runpath(path):
    entries = re.findall(r"\((?:RUNPATH|RPATH)\)\s+Library r(?:un)?path: \[(.*)\]", readelf("--dynamic", path))
    return [folder for entry in entries for folder in entry.split(":")]


def loaded(path):
    """The libraries that the loader maps: those that the program needs, and those that libraries need."""
    said = subprocess.run(["ldd", path], capture_output=True, text=True, check=True).stdout
    return set(re.findall(r"^\s+(\S+\.so[.\d]*) ", said, re.MULTILINE))


def symbols(path):
    return set(re.findall(r"\bUND (\w+)", readelf("--dyn-syms", path)))


def test_no_library_is_looked_for_in_the_current_folder(programs, private_libraries):
    """An empty element is the current folder to the loader, and so is what does not begin at the root."""
    wrong = {path.name: runpath(path) for path in programs + private_libraries
             if any(not folder.startswith(("/", "$ORIGIN")) for folder in runpath(path))}
    assert not wrong


def test_programs_find_their_private_libraries_beside_them(bin_dir, programs, private_libraries):
    for path in programs:
        needed = set(re.findall(r"\(NEEDED\).*\[(.*)\]", readelf("--dynamic", path)))
        folders = [folder.replace("$ORIGIN", str(path.parent)) for folder in runpath(path)]
        assert not any(folder.startswith("/opt/") for folder in folders), path
        for library in private_libraries:
            if library.name in needed:
                assert [folder for folder in folders if library.samefile(f"{folder}/{library.name}")] == folders


@pytest.mark.parametrize("name", ["calibd", "calibctl"])
def test_what_runs_in_a_vehicle_maps_no_codecs_that_it_does_not_need(bin_dir, name):
    """OpenCV's codecs need more than a hundred libraries, such as GDAL; JPEG and PNG need two."""
    libraries = loaded(bin_dir / name)
    assert any(library.startswith("libc.so") for library in libraries), libraries
    assert not [library for library in libraries if re.match("libopencv_imgcodecs|libgdal|libtiff", library)]


def test_the_private_cyclone_dds_knows_no_types_of_others(private_libraries):
    for library in private_libraries:
        if library.name.startswith("libddsc"):
            assert b"ddsi_xt_type_add_typeobj" not in library.read_bytes()


def test_programs_are_position_independent(programs):
    assert not [path.name for path in programs if not re.search(r"FLAGS_1.*\bPIE\b", readelf("--dynamic", path))]


def test_relocations_are_resolved_at_start_and_read_only_then(programs):
    def full_relro(path):
        return "GNU_RELRO" in readelf("--program-headers", path) and "BIND_NOW" in readelf("--dynamic", path)

    assert not [path.name for path in programs if not full_relro(path)]


def test_no_memory_of_a_program_can_be_written_and_run(programs):
    segment = re.compile(r"^\s*(?:LOAD|GNU_STACK)\s+(?:0x\w+\s+){5}(.{3})", re.MULTILINE)
    flags = {path.name: segment.findall(readelf("--program-headers", path)) for path in programs}
    assert all(flags.values())
    assert not [name for name, found in flags.items() if any("W" in one and "E" in one for one in found)]


@pytest.mark.parametrize("name", ["calibd", "calibctl", "calib-eval"])
def test_stacks_and_copies_are_checked(bin_dir, name):
    imported = symbols(bin_dir / name)
    assert "__stack_chk_fail" in imported
    assert any(re.fullmatch(r"__\w+_chk", symbol) for symbol in imported - {"__stack_chk_fail"}), "FORTIFY"


def test_the_private_cyclone_dds_is_hardened(private_libraries):
    libraries = [library for library in private_libraries if library.name.startswith("libddsc")]
    if not libraries:
        pytest.skip("calibd uses the distribution's Cyclone DDS")
    dynamic, imported = readelf("--dynamic", libraries[0]), symbols(libraries[0])
    assert "BIND_NOW" in dynamic and "__stack_chk_fail" in imported and "__memcpy_chk" in imported


def test_calibd_bears_a_build_id(bin_dir):
    assert re.search(r"Build ID: [0-9a-f]{40}\b", readelf("--notes", bin_dir / "calibd"))


def test_branches_are_protected_in_all_that_is_compiled_here(bin_dir):
    """Of a whole program it cannot be told: the linker keeps the property only when every object has it, and the start-up
    files of Debian's C library have not."""
    feature = {"x86_64": "x86 feature: IBT, SHSTK", "aarch64": "AArch64 feature: BTI, PAC"}.get(platform.machine())
    if feature is None:
        pytest.skip(f"nothing is known about {platform.machine()}")
    archives = sorted(bin_dir.parent.glob("*/lib*.a"))
    assert {"libcalibd_service.a", "libcalibd_messages.a", "libcalib.a"} <= {path.name for path in archives}
    for archive in archives:
        objects = re.split(r"^File: ", readelf("--notes", archive), flags=re.MULTILINE)[1:]
        assert objects and not [text.splitlines()[0] for text in objects if feature not in text]


@pytest.mark.parametrize("properties", ["TYPE_DISCOVERY_IS_AVAILABLE ON", "VERSION 1"], ids=["on", "not told"])
def test_a_cyclone_dds_with_type_discovery_is_refused(source_dir, tmp_path, properties):
    (tmp_path / "CycloneDDSConfig.cmake").write_text(
        "add_library(CycloneDDS::ddsc SHARED IMPORTED)\n"
        f"set_target_properties(CycloneDDS::ddsc PROPERTIES IMPORTED_LOCATION /nowhere/libddsc.so {properties})\n")
    configured = subprocess.run(["cmake", "-S", source_dir, "-B", tmp_path / "build", "-G", "Ninja", "-DBUILD_TESTING=OFF",
                                 f"-DCycloneDDS_DIR={tmp_path}"], capture_output=True, text=True, check=False)
    assert configured.returncode != 0
    said = " ".join(configured.stderr.split())
    assert "/nowhere/libddsc.so is built with type discovery" in said and "Run tools/setup" in said, configured.stderr


def test_the_project_configures_without_its_tests_and_without_onnx_runtime(source_dir, tmp_path):
    configured = subprocess.run(["cmake", "-S", source_dir, "-B", tmp_path, "-G", "Ninja", "-DBUILD_TESTING=OFF",
                                 "-DCALIB_WITH_ONNX=OFF"], capture_output=True, text=True, check=False)
    assert configured.returncode == 0, configured.stderr
