"""calibd as a process that is started, asked, counted and ended."""

import json
import os
import pathlib
import re
import socket
import subprocess
import tempfile
import time


class SetupFailed(Exception):
    """Nothing can be said of the figures; the text says what was in the way."""


def run(*command, **options):
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, **options)
    if done.returncode != 0:
        raise SetupFailed(f"{' '.join(map(str, command))} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


class Programs:
    """What was started; all of it ends, by process id, with the `with` block."""

    def __init__(self):
        self.running = []

    def start(self, *command, **options):
        self.running.append(subprocess.Popen([str(word) for word in command], stdout=subprocess.DEVNULL, **options))
        return self.running[-1]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        for process in self.running:
            process.terminate()
        for process in self.running:
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


class Daemon:
    """calibd at work, as the kernel counts it."""

    def __init__(self, program, folder, domain, pairs):
        self.program, self.folder = program, folder
        self.runtime = pathlib.Path(tempfile.mkdtemp(prefix="calibd-", dir="/dev/shm"))  # as /run, it is no disk
        self.socket = self.runtime / "control.sock"
        (folder / "calibd.yaml").write_text(
            f"vehicle: footprint-car\nstate_dir: {folder}/state\nruntime_dir: {self.runtime}\n"
            f"dds: {{domain: {domain}, interface: lo}}\nsigning_key: {folder}/signing.key\n" + pairs)

    def start(self, programs):
        """Seconds from exec to the first answer."""
        started = time.monotonic()
        with (self.folder / "calibd.log").open("ab") as log:
            self.process = programs.start(self.program, "--config", self.folder / "calibd.yaml", stderr=log)
        while self.status() is None:
            if self.process.poll() is not None or time.monotonic() > started + 30:
                raise SetupFailed(f"calibd does not answer:\n{self.log()}")
            time.sleep(0.002)
        return time.monotonic() - started

    def stop(self):
        """Seconds from SIGTERM to its end."""
        asked = time.monotonic()
        self.process.terminate()
        if self.process.wait(30) != 0:
            raise SetupFailed(f"calibd ended with {self.process.returncode}:\n{self.log()}")
        return time.monotonic() - asked

    def status(self):
        try:
            with socket.socket(socket.AF_UNIX) as client:
                client.connect(str(self.socket))
                client.sendall(b'{"schema":1,"request":"status"}\n')
                return json.loads(b"".join(iter(lambda: client.recv(65536), b"")))["status"]
        except OSError:
            return None

    def log(self):
        return (self.folder / "calibd.log").read_text(errors="replace")[-3000:]

    def proc(self, name):
        return pathlib.Path(f"/proc/{self.process.pid}/{name}")

    def memory(self, key):
        return int(re.search(rf"^{key}:\s+(\d+) kB", self.proc("status").read_text(), re.MULTILINE)[1]) * 1024

    def cpu_s(self):
        fields = self.proc("stat").read_text().rsplit(")", 1)[1].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    def written(self):
        return int(re.search(r"^write_bytes: (\d+)", self.proc("io").read_text(), re.MULTILINE)[1])

    def switches(self):
        """Voluntary context switches of each thread that lives."""
        counts = {}
        for task in self.proc("task").iterdir():
            try:
                counts[task.name] = int(re.search(r"^voluntary_ctxt_switches:\s+(\d+)", (task / "status").read_text(),
                                                  re.MULTILINE)[1])
            except (FileNotFoundError, ProcessLookupError):
                pass  # it has just ended
        return counts
