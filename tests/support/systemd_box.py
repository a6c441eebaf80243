"""A systemd of its own: the real one, as process 1 of new name spaces, over a copy-on-write view of this machine's files."""

import os
import pathlib
import shutil
import subprocess
import time

SYSTEMD = pathlib.Path("/usr/lib/systemd/systemd")

BOOT = r"""
set -e
mount --make-rprivate /
mount -t tmpfs tmpfs "$1"
mkdir "$1/upper" "$1/work" "$1/root"
root="$1/root"
mount -t overlay overlay -o "lowerdir=/,upperdir=$1/upper,workdir=$1/work" "$root"
mount -t proc proc "$root/proc"
mount --rbind /dev "$root/dev"
mount -t sysfs -o ro sysfs "$root/sys"
mount -t tmpfs tmpfs "$root/sys/fs/cgroup"
mount -t cgroup2 cgroup2 "$root/sys/fs/cgroup"
mount -t tmpfs tmpfs "$root/run"
rm -rf "$root"/etc/systemd/system/*.wants "$root"/etc/calibd "$root"/var/lib/calibd "$root"/var/log/journal
mount --make-rshared "$root"  # credentials of units reach them by propagation
exec env -i container=unshare PATH=/usr/sbin:/usr/bin:/sbin:/bin \
  chroot "$root" /usr/lib/systemd/systemd --system --unit=basic.target --log-target=journal --show-status=no
"""


class Box:
    """Use `make`; None where this machine does not allow it."""

    def __init__(self, process, init, root):
        self.process, self.init, self.root = process, init, root

    @classmethod
    def make(cls, folder):
        """`folder` is an empty one on this machine; the box sees all files of this machine, and changes none."""
        if os.geteuid() != 0 or not SYSTEMD.exists() or not all(map(shutil.which, ("unshare", "nsenter", "mount"))):
            return None
        process = subprocess.Popen(["unshare", "-m", "-p", "-u", "-i", "-C", "-n", "-f", "--kill-child", "sh", "-c", BOOT, "boot",
                                    str(folder)], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 30
        while process.poll() is None and time.monotonic() < deadline:
            children = pathlib.Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
            if children and pathlib.Path(f"/proc/{children[0]}/comm").read_text().strip() == "systemd":
                box = cls(process, children[0], pathlib.Path(f"/proc/{children[0]}/root"))
                if box.run("systemctl", "is-system-running", "--wait").out.strip() in ("running", "degraded"):
                    box.run("ip", "link", "set", "lo", "up")
                    return box
            time.sleep(0.1)
        process.kill()
        process.wait()
        return None

    def run(self, *command, check=False, timeout=60):
        ended = subprocess.run(["nsenter", "-t", self.init, "-a", "-r", *map(str, command)], capture_output=True, text=True,
                               check=False, timeout=timeout)
        if check and ended.returncode != 0:
            raise AssertionError(f"{command}: {ended.stdout}{ended.stderr}")
        ended.out = ended.stdout
        return ended

    def write(self, path, text, mode=0o644):
        file = self.root / path.lstrip("/")
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        file.chmod(mode)

    def show(self, unit, *properties):
        shown = self.run("systemctl", "show", unit, *(f"-p{name}" for name in properties), check=True).out
        return dict(line.split("=", 1) for line in shown.splitlines())

    def journal(self, unit):
        """Messages of the unit and about it, oldest first, as their fields."""
        import json
        lines = self.run("journalctl", "-u", unit, "-o", "json", "--no-pager", check=True).out.splitlines()
        return [json.loads(line) for line in lines]

    def close(self):
        self.process.kill()
        self.process.wait()
