"""A program that knows nothing of calibd: `foreign_types.py write|read DOMAIN COUNT` has COUNT topics, whose types in the
reading program are not those of the writing one but can be read as them, which each asks the other about.

The reading one ends when every pair has found together, the writing one at the end of its standard input."""

import sys
import time
import types
from dataclasses import dataclass

import ros
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import appendable
from cyclonedds.idl.types import float64, int32, sequence, uint8

SECONDS = 60


def foreign_type(number, more):
    """No two numbers share a type, so that none of them was asked about before."""
    members = {"octet": uint8, f"number_{number}": int32, "bytes": sequence[uint8]} | more
    made = types.new_class(f"Foreign{number}", (IdlStruct,), {"typename": f"foreign.Foreign{number}"},
                           lambda body: body.update(__annotations__=members, __module__=__name__))
    return appendable(dataclass(made))


def main(side, domain, count):
    peer = ros.Peer(domain)
    make, more = (peer.writer, {}) if side == "write" else (peer.reader, {"more": sequence[uint8], "last": float64})
    entities = [make(foreign_type(number, more), f"/foreign_{number}") for number in range(count)]
    print("ready", flush=True)
    if side == "write":
        sys.stdin.read()
        return
    end = time.monotonic() + SECONDS
    alone = entities
    while alone and time.monotonic() < end:
        alone = [reader for reader in alone if not reader.get_matched_publications()]
        time.sleep(0.05)
    sys.exit(f"{len(alone)} of {count} have found no writer" if alone else 0)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
