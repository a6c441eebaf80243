#!/usr/bin/env python3
"""calibd.yaml(5), for scdoc: the installed configuration, whose comments explain every key, in lines of a terminal's width.

  systemd/manual_page.py <systemd/calibd.yaml >calibd.yaml.5.scd
"""

import re
import sys
import textwrap

WIDTH = 72  # of 80, less the indentation of a page
OPENING = """calibd.yaml(5)

# NAME

calibd.yaml - the configuration of calibd

# DESCRIPTION

calibd reads _/etc/calibd/calibd.yaml_ when it starts. *calibctl check-config* _FILE_ reads a file in the same way and prints the
first error, with file, line and key. The file that is installed has values of nobody's vehicle, with which calibd does not start.
All keys, their units, ranges and defaults:

```
"""
CLOSING = """```

# SEE ALSO

*calibd*(8), *calibctl*(1), *calibd-model*(5), *calibd-messages*(5)
"""


KEY, ITEM, ROW = r"(?:[a-z_]+|T_[a-z_]+):(?: |$)", r"- ", r"[a-z_]+  +\S"


def continues(text, before):
    """Whether a comment's line goes on with the sentence of the one before: it is no key, no item of a list and no row of a
    table. After one of these it has to be indented."""
    words = text.lstrip()
    if not words or not before or re.match(f"{KEY}|{ITEM}|{ROW}", words):
        return False
    return text.startswith("  ") or not re.match(f"{KEY}|{ITEM}|{ROW}", before.lstrip())


def wrapped(indent, text):
    """The lines of a comment. A long one beside a key that is commented out goes above it."""
    width = max(WIDTH - len(indent), 40)
    beside = re.match(rf"( *)({KEY}.*?) +# (.*)$", text)
    if beside and len(text) > width - 2:
        return wrapped(indent, beside.group(1) + beside.group(3)) + [f"{indent}# {beside.group(1)}{beside.group(2)}"]
    words = text.lstrip()
    first = f"{indent}# {' ' * (len(text) - len(words))}"
    further = first + ("  " if re.match(f"{KEY}|{ITEM}|{ROW}", words) else "")
    return textwrap.wrap(words, width + len(indent), initial_indent=first, subsequent_indent=further,
                         break_long_words=False, break_on_hyphens=False) or [f"{indent}#"]


def reflow(lines):
    indent, text = None, ""  # of the comment that is being collected
    for line in [*lines, None]:
        comment = re.match(r"( *)# ?(.*)$", line or "")
        if comment and indent == comment.group(1) and continues(comment.group(2), text):
            text += " " + comment.group(2).lstrip()
            continue
        if indent is not None:
            yield from wrapped(indent, text)
        indent, text = comment.groups() if comment else (None, "")
        if comment or line is None:
            continue
        beside = re.match(r"( *)(\S.*?) +# (.*)$", line)
        if beside and len(line) > WIDTH:  # the comment goes above its key
            yield from wrapped(beside.group(1), beside.group(3))
            line = beside.group(1) + beside.group(2)
        yield line


def main():
    sys.stdout.write(OPENING + "\n".join(reflow(sys.stdin.read().splitlines())) + "\n" + CLOSING)


if __name__ == "__main__":
    main()
