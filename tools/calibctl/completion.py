#!/usr/bin/env python3
"""Completion of calibctl's commands and options in bash and zsh, made of what the program says with --help.

  tools/calibctl/completion.py bash|zsh CALIBCTL
"""

import re
import subprocess
import sys

FILE_OPTIONS = re.compile(r"--(?:socket|config|public-key|out|with|image|cloud|recording)$")
FOLDER_OPTIONS = re.compile(r"--(?:state-dir|to|export|overlay|journal)$")
FILE_COMMANDS = ("verify", "import", "check-config", "check-model", "rotate-key")


def said(program, *words):
    return subprocess.run([program, *words, "--help"], capture_output=True, text=True, check=True).stdout


def section(text, name):
    found = re.search(rf"^{name}:\n((?:  .*\n?)*)", text, re.MULTILINE)
    return found.group(1) if found else ""


def options_of(text):
    """Each option with what it takes: None for a flag; the words, a list; "file", "folder" or "word"."""
    options = {}
    text = re.sub(r"(--[\w-]+)\{\w+\}", r"\1 ", section(text, "Options"))  # what a flag sets
    entries = re.split(r"\n(?=  -)", "\n" + text)[1:]
    for entry in entries:
        head, _, rest = entry.strip().partition("\n")
        # The description begins after two spaces, or on the next line.
        spelling, _, description = head.partition("  ")
        value = re.search(r" (?:TEXT|UINT|INT|FLOAT|ENUM|BOOLEAN)\S*", spelling)
        listed = re.search(r":\{(.*?)\}", spelling) or (value and re.match(r"([a-z0-9_-]+(?:, [a-z0-9_-]+)* or [a-z0-9_-]+)$",
                                                                          (description or rest).strip()))
        words = re.findall(r"[\w-]+", re.sub(r" or ", " ", listed.group(1))) if listed else []
        for name in spelling.split(" ")[0].split(","):
            is_path = value and value.group(0).startswith(" TEXT")
            options[name] = (None if not value else words or ("folder" if is_path and FOLDER_OPTIONS.match(name) else
                                                              "file" if is_path and FILE_OPTIONS.match(name) else "word"))
    return options


def commands_of(text):
    return dict(re.findall(r"^  (\S+) +(\S.*)$", section(text, "Subcommands"), re.MULTILINE))


def takes_pair(text):
    return re.search(r"^  PAIR\b", section(text, "Positionals"), re.MULTILINE) is not None


def bash(options, commands, details):
    """A case for each command; `_calibctl_pairs` asks the running daemon."""
    lines = ["# bash completion of calibctl, made of its --help", "_calibctl() {",
             '  local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD-1]} command= i', "  COMPREPLY=()",
             "  for ((i = 1; i < COMP_CWORD; ++i)); do",
             f"    case ${{COMP_WORDS[i]}} in {'|'.join(commands)}) command=${{COMP_WORDS[i]}}; break ;; esac", "  done",
             "  case $command:$before in"]
    for command, found in [("", options), *((name, details[name][0]) for name in commands)]:
        for name, words in found.items():
            if words is None:
                continue
            made = {"file": 'COMPREPLY=($(compgen -f -- "$word")); ', "folder": 'COMPREPLY=($(compgen -d -- "$word")); ',
                    "word": ""}.get(str(words), f'COMPREPLY=($(compgen -W "{" ".join(words)}" -- "$word")); ')
            lines.append(f"    {command or '*'}:{name}) {made}return ;;")
    lines += ["  esac", "  case $command in",
              f'    "") COMPREPLY=($(compgen -W "{" ".join([*options, *commands])}" -- "$word")) ;;']
    for name in commands:
        found, pairs = details[name]
        more = " $(_calibctl_pairs)" if pairs else ""
        files = ' $(compgen -f -- "$word")' if name in FILE_COMMANDS else ""
        lines.append(f'    {name}) COMPREPLY=($(compgen -W "{" ".join(found)}{more}" -- "$word"){files}) ;;')
    lines += ["  esac", "}", "", "_calibctl_pairs() {",
              """  calibctl status --json 2>/dev/null | grep -o '"name": *"[a-z0-9_-]*"' | cut -d '"' -f 4""", "}",
              "complete -o filenames -F _calibctl calibctl", ""]
    return "\n".join(lines)


def zsh(options, commands, details):
    def quoted(text):
        return text.replace("'", "'\\''").replace(":", "\\:").replace("[", "\\[").replace("]", "\\]")

    def specs(found):
        for name, words in found.items():
            value = {"None": "", "file": ":file:_files", "folder": ":folder:_files -/", "word": ":word:"}.get(
                str(words), f":word:({' '.join(words or [])})")
            yield f"'{name}{value}'"

    lines = ["#compdef calibctl", "# zsh completion of calibctl, made of its --help", "", "_calibctl_pairs() {",
             "  local -a pairs",
             """  pairs=(${(f)"$(calibctl status --json 2>/dev/null | grep -o '"name": *"[a-z0-9_-]*"' | cut -d '"' -f 4)"})""",
             "  compadd -a pairs", "}", "", "_calibctl() {", "  local context state line", "  local -a commands", "  commands=("]
    lines += [f"    '{name}:{quoted(description)}'" for name, description in commands.items()]
    lines += ["  )", f"  _arguments -C {' '.join(specs(options))} '1:command:->command' '*::argument:->argument'",
              "  case $state in", "    command) _describe command commands ;;", "    argument)", "      case $words[1] in"]
    for name in commands:
        found, pairs = details[name]
        rest = "'*:pair:_calibctl_pairs'" if pairs else "'*:file:_files'" if name in FILE_COMMANDS else ""
        lines.append(f"        {name}) _arguments {' '.join(specs(found))} {rest} ;;")
    lines += ["      esac ;;", "  esac", "}", "", '_calibctl "$@"', ""]
    return "\n".join(lines)


def main():
    if len(sys.argv) != 3 or sys.argv[1] not in ("bash", "zsh"):
        sys.exit(__doc__)
    shell, program = sys.argv[1:]
    top = said(program)
    commands = commands_of(top)
    details = {}
    for name in commands:
        text = said(program, name)
        details[name] = (options_of(text), takes_pair(text))
    print((bash if shell == "bash" else zsh)(options_of(top), commands, details), end="")


if __name__ == "__main__":
    main()
