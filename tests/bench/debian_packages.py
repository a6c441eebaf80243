"""What Debian packages a program needs, of those that are installed here."""

import os
import re
import subprocess


def closure(packages, known):
    """Packages with all that they depend on; of alternatives the first that is known."""
    found, todo = set(), list(packages)
    while todo:
        if (package := todo.pop()) not in found and package in known:
            found.add(package)
            for group in known[package]["depends"]:
                todo += [name for name in group if name in known][:1]
    return found


def owners(libraries):
    """The packages that hold these files."""
    names = set()
    for path in libraries:
        for spelt in {path, path.removeprefix("/usr"), "/usr" + path}:  # /lib is a link to /usr/lib
            found = subprocess.run(["dpkg", "-S", spelt], capture_output=True, text=True, check=False)
            names |= set(re.findall(r"^([^:,\s]+)", found.stdout, re.MULTILINE))
    return names


def libraries(programs):
    """The files that the loader finds for them."""
    listings = [subprocess.run(["ldd", program], capture_output=True, text=True, check=True).stdout for program in programs]
    return {os.path.realpath(path) for listing in listings for path in re.findall(r"=> (/\S+)", listing)}


def installed_packages():
    fields = "${Package}\\t${Priority}\\t${Essential}\\t${Installed-Size}\\t${Pre-Depends}, ${Depends}\\n"
    known = {}
    for line in subprocess.run(["dpkg-query", "-W", "-f", fields], capture_output=True, text=True,
                               check=True).stdout.splitlines():
        name, priority, essential, size, depends = line.split("\t")
        groups = [[re.split(r"[ (:]", word.strip())[0] for word in group.split("|")] for group in depends.split(",")]
        known[name] = {"required": priority == "required" or essential == "yes", "kB": int(size or 0), "depends": groups}
    return known


def needed(programs):
    """Of their libraries, with all that these packages depend on, less what a bare system has: the packages of priority
    `required` with all that they depend on. Their number, their installed size in bytes, and the number of libraries."""
    files, known = libraries(programs), installed_packages()
    bare = closure([name for name, package in known.items() if package["required"]], known)
    names = closure(owners(files), known) - bare
    return len(names), sum(known[name]["kB"] for name in names) * 1024, len(files)
