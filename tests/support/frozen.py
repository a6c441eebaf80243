"""One thread of a program that does not go on, while the others do: what a hang looks like from outside."""

import ctypes
import os
import time

PTRACE_SEIZE, PTRACE_INTERRUPT, PTRACE_DETACH = 0x4206, 0x4207, 17
WALL = 0x40000000


def thread_of(pid, name):
    for task in os.listdir(f"/proc/{pid}/task"):
        with open(f"/proc/{pid}/task/{task}/comm", encoding="ascii") as comm:
            if comm.read().strip() == name:
                return int(task)
    raise AssertionError(f"calibd has no thread {name}")


class Frozen:
    """One thread of a program that does not go on; the others do."""

    def __init__(self, thread):
        self.thread, self.libc = thread, ctypes.CDLL(None, use_errno=True)

    def _ptrace(self, request):
        assert self.libc.ptrace(request, self.thread, None, None) == 0, os.strerror(ctypes.get_errno())

    def __enter__(self):
        self._ptrace(PTRACE_SEIZE)
        self._ptrace(PTRACE_INTERRUPT)

    def wait_for_end(self, seconds):
        """Whoever traces a thread has to take note of its end."""
        deadline = time.monotonic() + seconds
        while True:
            thread, status = os.waitpid(self.thread, WALL | os.WNOHANG)
            if thread and not os.WIFSTOPPED(status):
                return
            assert time.monotonic() < deadline, "calibd has not ended"
            time.sleep(0.01)

    def __exit__(self, *_):
        os.waitpid(self.thread, WALL)
        self._ptrace(PTRACE_DETACH)
