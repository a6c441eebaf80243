"""How sources are compiled, for tools that only look at them: from the build folder's compile_commands.json."""

import json
import re
import shlex


def all_flags(bin_dir):
    """By source file: the compiler, and the flags that decide what the source means; no precompiled headers."""
    found = {}
    for entry in json.loads((bin_dir.parent / "compile_commands.json").read_text()):
        words = shlex.split(entry["command"])
        first = next(i for i, word in enumerate(words) if re.search(r"(\+\+|cc|clang|gcc)(-\d+)?$", word) and "ccache" not in word)
        flags, following = [], False
        for word in words[first + 1:]:
            if following or re.match(r"-(I|D|U|std|m)\w?", word):
                flags.append(word)
            elif word == "-isystem":
                flags.append(word)
            following = word == "-isystem"
        found[entry["file"]] = (words[first], flags)
    return found
