"""What calibctl prints with --json is what proto/ says, for every command that prints something; and it is there at once."""

import json
import subprocess
import time

import pytest

from conftest import DONE, FAILED, NO, USAGE

# With files of their own for a schema, and tests of their own.
ELSEWHERE = {"status", "wait", "doctor", "show", "reload", "alerts"}
CHECKED = {"events", "history", "verify", "export", "recalibrate", "accept", "rollback", "rotate-key", "import", "explain", "check-config",
           "check-model", "keygen"}


@pytest.fixture(scope="session")
def form(source_dir):
    """Validates a text against a definition of calibctl.schema.json, and returns what it says."""
    jsonschema = pytest.importorskip("jsonschema")
    schema = json.loads((source_dir / "proto/calibctl.schema.json").read_text())
    jsonschema.Draft202012Validator.check_schema(schema)

    def validate(name, text):
        assert text.isascii()
        value = json.loads(text)
        jsonschema.Draft202012Validator({**schema, "$ref": f"#/$defs/{name}"}).validate(value)
        return value

    return validate


def commands_of(calibctl):
    listed = calibctl("--help").out.split("Subcommands:\n")[1]
    return {line.split()[0] for line in listed.splitlines() if line.startswith("  ") and not line.startswith("   ")}


def test_every_command_has_json_and_a_form(calibctl):
    commands = commands_of(calibctl)
    known = ELSEWHERE | CHECKED
    assert known <= commands
    for command in commands:
        assert "--json" in calibctl(command, "--help").out, command
    assert not commands - known, "add the command to this test, and its form to proto/"


def test_records(calibctl, form, tmp_path):
    history = form("history", calibctl("history", "--json").out)
    assert [record["decision"] for record in history["records"]] == ["initial", "rejected", "accepted"]
    assert history["records"][2]["change"]["rotation_deg"][0] == pytest.approx(-0.25, abs=0.01) and history["broken"] is None
    assert calibctl("history", "rear", "--json").out == ""
    assert form("verify", calibctl("verify", "--json").out)["verified"] == 3
    out = tmp_path / "out"
    assert form("export_all", calibctl("export", "--all", "--to", out, "--json").out)["exported"] == 3
    files = form("verify", calibctl("verify", "--json", *out.iterdir()).out)
    assert (files["verified"], files["links"]) == (3, 2)
    assert calibctl("export", "--format", "tf", "--json").exit == USAGE
    (calibctl.folder / "calibd.db").unlink()
    gone = calibctl("verify", "--json")
    assert gone.out == "" and gone.err


@pytest.mark.parametrize("command", [["recalibrate", "front"], ["recalibrate", "front", "--dry-run"], ["accept", "front"],
                                     ["rollback", "front", "--to", "2"]])
def test_requests_print_the_answer(calibctl, peer, form, command):
    transform = {"translation_m": [0, 0, 1], "quaternion_xyzw": [0, 0, 0, 1]}
    result = {"T_camera_lidar": transform, "change": {"rotation_deg": [0, 0, 1], "translation_cm": [0, 0, 0]},
              "score": {"before": 1, "after": 2, "held_back_before": 1, "held_back_after": 2}}
    for answer, exit_code in (({"answer": "accepted", "record": 4}, DONE), ({"answer": "rejected", "record": 4}, NO),
                              ({"answer": "dry_run", "would": "rejected", "record": None}, NO)):
        reply = {"ok": True, "reason": "because", "result": result, **answer}
        listening = peer(reply)
        said = calibctl(*command, "--json")
        assert form("decision", said.out) == reply and said.exit == exit_code
        listening.close()
        calibctl.socket.unlink()
    peer({"ok": False, "code": "denied", "message": "no"})
    refused = calibctl(*command, "--json")
    assert refused.exit == FAILED and refused.out == ""


def test_what_needs_no_daemon(bare, form, source_dir, tmp_path):
    made = form("keygen", bare("keygen", "--out", bare.key, "--json").out)
    assert made["secret_key"] == str(bare.key) and made["key"] in bare.public_key.read_text()
    assert form("explain", bare("explain", "wrong_topic", "--json").out)["code"] == "wrong_topic"
    assert "malformed:stamp" in form("codes", bare("explain", "--json").out)["codes"]

    text = (source_dir / "systemd/calibd.yaml").read_text().replace("vehicle: demo-car", "vehicle: car-1")
    file = tmp_path / "a.yaml"
    file.write_text(text)
    good = form("check_config", bare("check-config", file, "--json").out)
    assert good["valid"] and good["warnings"] == [] and good["error"] is None
    file.write_text(text.replace("interface: auto", "interface: nosuch0"))
    slip = form("check_config", bare("check-config", file, "--json").out)
    assert slip["valid"] and "there is no network interface nosuch0" in slip["warnings"][0]
    file.write_text(text.replace("vehicle:", "vehikel:"))
    wrong = bare("check-config", file, "--json")
    assert wrong.exit == FAILED and wrong.err == ""
    wrong = form("check_config", wrong.out)
    assert not wrong["valid"] and wrong["error"].startswith(f"{file}:") and "vehikel" in wrong["error"]

    tf = tmp_path / "tf"
    tf.write_text("static_transform_publisher --x 0.1 --y 0.2 --z 0.3 --qx -0.5 --qy 0.5 --qz -0.5 --qw 0.5 "
                  "--frame-id lidar --child-frame-id camera\n")
    form("import", bare("import", "--format", "tf", tf, "--camera", "camera", "--lidar", "lidar", "--no-check", "--json").out)


def test_a_network(bare, form, source_dir):
    checked = bare("check-model", source_dir / "libcalib/models/street-small.yaml", "--json", "--runs", "1")
    if "ONNX" in checked.err:
        pytest.skip("built without ONNX Runtime")
    form("check_model", checked.out)


def test_output_comes_within_50_ms(calibctl, slowdown):
    """The quickest of several runs: other programs of the machine do not count."""
    for command in (["--version"], ["status"], ["history"], ["explain", "wrong_topic"], ["events", "--journal", calibctl.folder]):
        times = []
        for _ in range(10):
            start = time.monotonic()
            subprocess.run(calibctl.command(*command), capture_output=True, check=False)
            times.append(time.monotonic() - start)
        assert min(times) < 0.05 * slowdown, (command, times)


def test_no_colour_where_none_is_wanted(calibctl):
    """On a terminal, which pytest is not: script makes one."""
    for environment, coloured in (({}, True), ({"NO_COLOR": "1"}, False)):
        shown = subprocess.run(["script", "-qec", " ".join(map(str, calibctl.command("status"))), "/dev/null"],
                               capture_output=True, check=False, env={"PATH": "/usr/bin:/bin", "TERM": "xterm", **environment})
        assert (b"\x1b[3" in shown.stdout) == coloured
