"""A store, a key and a snapshot as a daemon leaves them, and calibctl to look at them."""

import json
import pathlib
import re
import socket
import subprocess
import threading
import types

import pytest

DONE, FAILED, USAGE, NOT_FOUND, NO = range(5)


class Calibctl:
    """Runs calibctl on the things in one folder."""

    def __init__(self, bin_dir, folder):
        self.program = bin_dir / "calibctl"
        self.folder = folder
        self.key = folder / "signing.key"
        self.public_key = folder / "signing.pub"
        self.store = folder / "calibd.db"
        self.snapshot = folder / "status.json"
        self.socket = folder / "control.sock"

    def command(self, *arguments):
        return [self.program, "--socket", self.socket, "--state-dir", self.folder, "--public-key", self.public_key,
                *arguments]

    def __call__(self, *arguments, **options):
        ended = subprocess.run(self.command(*arguments), capture_output=True, timeout=60, check=False, **options)
        return types.SimpleNamespace(exit=ended.returncode, out=ended.stdout.decode(), err=ended.stderr.decode())


def row_of(pair, table):
    """The cells of a pair in the table of `calibctl status`."""
    return next(re.split(r"  +", line.strip()) for line in table.splitlines() if line.startswith(pair + " "))


def unwrapped(text):
    """What `calibctl status` printed, with the lines joined that it broke at a space."""
    return text.replace("\n" + 16 * " " + ": ", " ")


@pytest.fixture
def bare(bin_dir, tmp_path):
    """calibctl with nothing there yet."""
    return Calibctl(bin_dir, tmp_path)


@pytest.fixture
def calibctl(bare, bin_dir):
    """calibctl with a key, three records and the snapshot of a calibrated pair."""
    assert bare("keygen", "--out", bare.key).exit == DONE
    write_store(bin_dir, bare, "calibrated")
    return bare


def write_store(bin_dir, calibctl, verdict, *more):
    subprocess.run([bin_dir / "tests" / "write_store", calibctl.key, calibctl.folder, verdict, *more], check=True)


@pytest.fixture(scope="session")
def evaluate(bin_dir):
    """Runs calib-eval."""

    def run(*arguments):
        ended = subprocess.run([bin_dir / "calib-eval", *map(str, arguments)], capture_output=True, text=True, timeout=250)
        return types.SimpleNamespace(exit=ended.returncode, out=ended.stdout, err=ended.stderr)

    return run


def numbers_of(path):
    """All of a result of `calib-eval calibrate` that does not depend on the clock."""
    result = json.loads(path.read_text())
    for entry in result["cells"]:
        del entry["seconds_per_run"]
    for entry in result["runs"]:
        del entry["seconds"]
    return result["cells"], result["runs"]


@pytest.fixture(scope="session")
def schema(source_dir):
    """Validates a value against proto/NAME.schema.json."""
    jsonschema = pytest.importorskip("jsonschema")

    def validate(name, value):
        text = json.loads((pathlib.Path(source_dir) / "proto" / f"{name}.schema.json").read_text())
        jsonschema.Draft202012Validator.check_schema(text)
        jsonschema.Draft202012Validator(text).validate(value)

    return validate


class Peer:
    """Listens in place of calibd and sends the given bytes to each client."""

    def __init__(self, path, reply):
        self.questions = []
        self.reply = reply
        self.socket = socket.socket(socket.AF_UNIX)
        self.socket.bind(str(path))
        self.socket.listen()
        self.thread = threading.Thread(target=self._serve, daemon=True)
        self.thread.start()

    def close(self):
        """Ends the thread first: else its `accept` may get the file descriptor of the next peer."""
        if self.socket.fileno() < 0:
            return  # closed already
        self.socket.shutdown(socket.SHUT_RDWR)
        self.thread.join()
        self.socket.close()

    def _serve(self):
        while True:
            try:
                connection, _ = self.socket.accept()
            except OSError:
                return
            with connection:
                self.questions.append(connection.makefile("rb").readline())
                try:
                    connection.sendall(self.reply)
                except OSError:
                    pass  # the client closed the connection


@pytest.fixture
def peer(calibctl):
    peers = []

    def listen(reply):
        peers.append(Peer(calibctl.socket, reply if isinstance(reply, bytes) else json.dumps(reply).encode() + b"\n"))
        return peers[-1]

    yield listen
    for each in peers:
        each.close()
