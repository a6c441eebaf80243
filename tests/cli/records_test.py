"""keygen, history, show and verify: a record that does not verify is never shown as if it did."""

import json
import os
import sqlite3
import stat
import subprocess

import pytest

from conftest import DONE, FAILED, NO, NOT_FOUND, USAGE, write_store


def tamper(calibctl, sql):
    with sqlite3.connect(calibctl.store) as database:
        assert database.execute(sql).rowcount == 1


def is_plain(text):
    """Nothing in it controls a terminal: no control character but the newline, and no character that reorders text."""
    return not any(c < " " and c != "\n" or "\x7f" <= c < "\xa0" or c in "\u202e\u2066" for c in text)


def sha256sum(file):
    return subprocess.run(["sha256sum", file], capture_output=True, check=True).stdout.decode().split()[0]


def test_keygen_makes_a_private_and_a_public_key_and_keeps_what_exists(bare):
    made = bare("keygen", "--out", bare.key)
    assert made.exit == DONE
    assert stat.S_IMODE(bare.key.stat().st_mode) == 0o600
    assert stat.S_IMODE(bare.public_key.stat().st_mode) == 0o644
    before = bare.key.read_bytes(), bare.public_key.read_bytes()
    again = bare("keygen", "--out", bare.key)
    assert again.exit == FAILED and "exists" in again.err
    assert before == (bare.key.read_bytes(), bare.public_key.read_bytes())
    key_id = before[1].decode().split("\n")[0].split()[-1]
    assert key_id in made.out
    assert bare("keygen").exit == USAGE
    assert bare("keygen", "--out", bare.public_key).exit == USAGE


def test_a_store_that_calibd_wrote_verifies(calibctl):
    verified = calibctl("verify")
    assert verified.exit == DONE and "3 records verified" in verified.out


def test_history_lists_every_record_with_its_decision(calibctl):
    history = calibctl("history")
    assert history.exit == DONE and history.err == ""
    lines = history.out.splitlines()
    assert lines[0].split() == ["SEQ", "DECIDED", "(UTC)", "PAIR", "DECISION", "CHANGE", "ASKED", "BY"]
    assert all(len(line) <= 100 for line in lines)
    rows = [line for line in lines[1:] if not line.startswith(" ")]
    assert [row.split()[0] for row in rows] == ["1", "2", "3"]
    for title in ("DECIDED", "PAIR", "DECISION", "CHANGE", "ASKED"):
        assert all(row[lines[0].index(title) - 1] == " " != row[lines[0].index(title)] for row in rows)
    assert [row.split()[4] for row in rows] == ["initial", "rejected", "accepted"]
    assert rows[2].split() == ["3", "2026-01-31", "12:02:00", "front", "accepted", "0.56", "deg,", "3.6", "cm", "calibd"]
    assert lines[lines.index(rows[2]) + 1] == "      better on the pairs held back"
    assert calibctl("history", "front").out == history.out


def test_history_of_an_unknown_pair_is_not_found(calibctl):
    history = calibctl("history", "rear\x1b[2J")
    assert history.exit == NOT_FOUND and is_plain(history.err)


def test_show_has_words_for_the_signs_of_a_change(calibctl):
    shown = calibctl("show")
    assert shown.exit == DONE
    for words in ("Record          : 3, verified", "Roll            : 0.25 degrees left side down",
                  "Pitch           : 0.00 degrees, sigma 0.06", "Yaw             : 0.50 degrees to the left",
                  "X               : 1.2 cm forward", "Z               : 3.4 cm down"):
        assert words in shown.out
    assert shown.out == calibctl("show", "3").out
    assert "Decision        : initial" in calibctl("show", "1").out


@pytest.mark.parametrize("arguments, exit_code", [(["show", "4"], NOT_FOUND), (["show", "0"], USAGE),
                                                  (["show", "-1"], USAGE), (["show", "x"], USAGE)])
def test_a_missing_record_is_not_found(calibctl, arguments, exit_code):
    shown = calibctl(*arguments)
    assert shown.exit == exit_code and shown.out == "" and shown.err != ""


def test_untrusted_text_does_not_control_the_terminal(calibctl):
    for command in (["history"], ["show", "2"], ["show", "2", "--json"], ["status", "front"], ["status", "--json"]):
        shown = calibctl(*command)
        assert is_plain(shown.out), command
        assert "title" in shown.out  # it is there, escaped
    assert is_plain(calibctl("status").out)


def test_the_json_of_a_record_is_the_record(calibctl, schema, tmp_path):
    for sequence in ("1", "2", "3"):
        shown = calibctl("show", sequence, "--json", "--export", tmp_path / "out")
        assert shown.exit == DONE
        record = json.loads(shown.out)
        schema("record", record)
        # The documented canonical form, by a program that shares nothing with ours.
        canonical = json.dumps(record, sort_keys=True, separators=(",", ":"), ensure_ascii=False).encode()
        assert canonical == (tmp_path / "out" / f"00000{sequence}.json").read_bytes()


def test_a_baseline_is_shown_verified_and_without_a_change(bare, bin_dir, schema, tmp_path):
    assert bare("keygen", "--out", bare.key).exit == DONE
    write_store(bin_dir, bare, "calibrated", "baseline")
    assert bare("verify").exit == DONE
    shown = bare("show")
    for words in ("Record          : 4, verified", "Decision        : baseline",
                  "Baseline        : from 20 pairs, score 1.25000, sigma 0.06250",
                  "Yaw             : slope 0.00873, sigma 0.03491, per degree; sensitivity 0.03046, sigma 0.00305",
                  "X               : slope 0.00500, sigma 0.02000, per cm; sensitivity 0.01000, sigma 0.00100"):
        assert words in shown.out, shown.out
    assert "Change" not in shown.out
    assert bare("history").out.splitlines()[-2].split()[3:] == ["front", "baseline", "-", "calibd"]
    assert bare("history").out.splitlines()[-1] == "      the baseline was learned from 20 pairs"
    record = json.loads(bare("show", "--json", "--export", tmp_path / "out").out)
    schema("record", record)
    del record["baseline"]
    with pytest.raises(Exception, match="baseline"):
        schema("record", record)
    # The extrinsic in force is still that of record 3.
    status = json.loads(bare("status", "--json").out)
    assert status["pairs"][0]["record"]["sequence"] == 3 and status["pairs"][0]["record"]["verified"] is True


def test_an_exported_record_can_be_verified_with_minisign_and_sha256sum_alone(calibctl, tmp_path):
    out = tmp_path / "out"
    for sequence in ("1", "2", "3"):
        assert calibctl("show", sequence, "--export", out).exit == DONE
    for sequence in (1, 2, 3):
        file = out / f"{sequence:06}.json"
        subprocess.run(["minisign", "-Vm", file, "-p", calibctl.public_key], check=True, capture_output=True)
        expected = sha256sum(out / f"{sequence - 1:06}.json") if sequence > 1 else "0" * 64
        assert json.loads(file.read_text())["previous_sha256"] == expected


def test_all_records_are_exported_at_once(calibctl, tmp_path):
    out, single = tmp_path / "out", tmp_path / "single"
    for _ in range(2):  # the second time nothing is left to be written
        done = calibctl("export", "--all", "--to", out)
        assert done.exit == DONE and done.out.startswith("3 records verified and exported")
    for sequence in ("1", "2", "3"):
        assert calibctl("show", sequence, "--export", single).exit == DONE
    assert {file.name: file.read_bytes() for file in out.iterdir()} == {file.name: file.read_bytes() for file in single.iterdir()}
    assert "3 records verified" in calibctl("verify", *out.iterdir()).out
    assert calibctl("export", "--to", out).exit == USAGE and calibctl("export", "--all").exit == USAGE
    tamper(calibctl, "UPDATE record SET canonical = replace(canonical, 'rejected', 'accepted') WHERE sequence = 2")
    some = calibctl("export", "--all", "--to", tmp_path / "some")
    assert some.exit == NO and some.out.startswith("1 record verified") and "record 2 does not verify" in some.err
    assert sorted(file.name for file in (tmp_path / "some").iterdir()) == ["000001.json", "000001.json.minisig"]


def test_an_export_replaces_no_file(calibctl, tmp_path):
    out = tmp_path / "out"
    assert calibctl("show", "1", "--export", out).exit == DONE
    record, signature = out / "000001.json", out / "000001.json.minisig"
    before = record.read_bytes(), signature.read_bytes()
    assert sorted(out.iterdir()) == [record, signature]
    assert calibctl("show", "1", "--export", out).exit == DONE, "the same record again"
    signature.unlink()
    assert calibctl("show", "1", "--export", out).exit == DONE, "an export that was stopped half way"
    assert before == (record.read_bytes(), signature.read_bytes())
    for path in (record, signature):
        path.write_text("another record")
        kept = calibctl("show", "1", "--export", out)
        assert kept.exit == FAILED and f"{path} exists already" in kept.err and kept.out == ""
        assert path.read_text() == "another record"
        path.unlink()


def test_an_export_follows_no_symbolic_link(calibctl, tmp_path):
    out, good, target = tmp_path / "out", tmp_path / "good", tmp_path / "target"
    out.mkdir()
    assert calibctl("show", "1", "--export", good).exit == DONE
    for name in ("000001.json", "000001.json.minisig"):
        # To nothing, to a file of somebody's, and even to what would be written.
        for content in (None, "untouched", (good / name).read_text()):
            target.unlink(missing_ok=True)
            if content is not None:
                target.write_text(content)
            (out / name).symlink_to(target)
            refused = calibctl("show", "1", "--export", out)
            assert refused.exit == FAILED and f"{out / name} exists already" in refused.err
            assert (target.read_text() if target.exists() else None) == content
            (out / name).unlink()
    (out / "000001.json").unlink()
    target.write_text("untouched")
    for name in ("000001.json.part", "000001.json.minisig.part"):
        (out / name).symlink_to(target)
    assert calibctl("show", "1", "--export", out).exit == DONE
    assert target.read_text() == "untouched" and len(list(out.iterdir())) == 2
    os.mkfifo(tmp_path / "fifo")
    assert calibctl("show", "1", "--export", tmp_path / "fifo").exit == FAILED

    if os.geteuid() == 0:
        (tmp_path / "theirs").symlink_to(tmp_path / "elsewhere")
        (tmp_path / "elsewhere").mkdir()
        os.lchown(tmp_path / "theirs", 65534, 65534)
        refused = calibctl("show", "1", "--export", tmp_path / "theirs")
        assert refused.exit == FAILED and "is a link that another user created" in refused.err
        assert not list((tmp_path / "elsewhere").iterdir())



def test_exported_records_verify_in_any_order_and_with_gaps(calibctl, tmp_path):
    out = tmp_path / "out"
    for sequence in ("1", "2", "3"):
        calibctl("show", sequence, "--export", out)
    everything = sorted(out.iterdir(), reverse=True)
    verified = calibctl("verify", *everything)
    assert verified.exit == DONE and "3 records verified" in verified.out and "2 links" in verified.out
    some = calibctl("verify", out / "000003.json", out / "000001.json")
    assert some.exit == DONE and "0 links" in some.out and "not among these files" in some.out
    assert calibctl("verify", out / "000009.json").exit == NOT_FOUND
    assert calibctl("verify", out / "000001.json.minisig").exit == USAGE

    record = out / "000002.json"
    good = record.read_bytes()
    record.write_bytes(good.replace(b"rejected", b"accepted"))
    bad = calibctl("verify", *everything)
    assert bad.exit == NO and "000002.json does not verify" in bad.err and "verified" not in bad.out
    record.write_bytes(good)
    (out / "000002.json.minisig").unlink()
    assert calibctl("verify", record).exit == NOT_FOUND


def test_signed_records_of_two_chains_do_not_verify_together(calibctl, bin_dir, tmp_path):
    out = tmp_path / "out"
    calibctl("show", "1", "--export", out)
    # The same key and another history: record 2 of a store whose record 1 says something else.
    record = json.loads((out / "000001.json").read_text())
    record.update(sequence=2, previous_sha256="1" * 64)
    forged = out / "000002.json"
    forged.write_text(json.dumps(record, sort_keys=True, separators=(",", ":"), ensure_ascii=False))
    subprocess.run(["minisign", "-S", "-s", calibctl.key, "-m", forged], check=True, capture_output=True)
    assert calibctl("verify", forged).exit == DONE
    both = calibctl("verify", out / "000001.json", forged)
    assert both.exit == NO and "does not continue the first" in both.err


@pytest.mark.parametrize("sql", [
    "UPDATE record SET canonical = replace(canonical, 'rejected', 'accepted') WHERE sequence = 2",
    "UPDATE record SET signature = (SELECT signature FROM record WHERE sequence = 1) WHERE sequence = 2",
    "DELETE FROM record WHERE sequence = 2"])
def test_an_altered_record_is_never_shown(calibctl, sql):
    tamper(calibctl, sql)
    verified = calibctl("verify")
    assert verified.exit == NO and verified.out == "" and "record 2 does not verify" in verified.err
    history = calibctl("history")
    rows = [line for line in history.out.splitlines()[1:] if not line.startswith(" ")]
    assert history.exit == NO and [row.split()[0] for row in rows] == ["1"]
    assert "2 records from there on not shown" in history.err
    assert calibctl("show", "1").exit == DONE
    for sequence in ("2", "3"):
        shown = calibctl("show", sequence, "--export", calibctl.folder / "out")
        assert shown.exit == NO and shown.out == "" and "record 2 does not verify" in shown.err
    assert not (calibctl.folder / "out").exists()


def test_the_error_for_another_key_names_it(calibctl, tmp_path):
    other = tmp_path / "other.key"
    assert calibctl("keygen", "--out", other).exit == DONE
    signer, calibctl.public_key = calibctl.public_key, tmp_path / "other.pub"
    verified = calibctl("verify")
    assert verified.exit == NO and verified.out == ""
    ids = [key.read_text().split("\n")[0].split()[-1] for key in (signer, calibctl.public_key)]
    assert f"signed by key {ids[0]}, you have {ids[1]}" in verified.err


def test_missing_files_are_not_found(bare, bin_dir):
    for command in (["verify"], ["history"], ["show"]):
        missing = bare(*command)
        assert missing.exit == NOT_FOUND and missing.out == ""
    bare("keygen", "--out", bare.key)
    subprocess.run([bin_dir / "tests" / "write_store", bare.key, bare.folder, "calibrated"], check=True)
    bare.public_key.unlink()
    for command in (["verify"], ["history"], ["show"]):
        assert bare(*command).exit == NOT_FOUND


def test_an_invalid_store_is_a_failure(calibctl):
    calibctl.store.write_bytes(b"this is no database " * 100)
    assert calibctl("verify").exit == FAILED


@pytest.mark.parametrize("arguments", [[], ["unknown"], ["show", "1", "2"], ["recalibrate"], ["rollback", "front", "--to", "x"],
                                       ["status", "--unknown"], ["accept"], ["check-config"]])
def test_wrong_usage_exits_with_2(calibctl, arguments):
    wrong = calibctl(*arguments)
    assert wrong.exit == USAGE and wrong.out == "" and wrong.err != ""


def test_help_and_version(calibctl):
    assert calibctl("--help").exit == DONE
    version = calibctl("--version")
    assert version.exit == DONE and version.out.startswith("calibctl ")


def test_output_that_cannot_be_written_is_a_failure(calibctl):
    with open("/dev/full", "wb") as full:
        ended = subprocess.run(calibctl.command("history"), stdout=full, stderr=subprocess.PIPE, check=False)
    assert ended.returncode == FAILED
