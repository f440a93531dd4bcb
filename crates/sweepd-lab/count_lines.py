#!/usr/bin/env python3
"""Counts lines of code: no tests, comments or blank lines, in default rustfmt.

    python3 crates/sweepd-lab/count_lines.py

prints them for each room, for the whole, and for each package that .ci/release ships, with all of ours that it is built from; and
how many functions have more than 60 lines, and how many closures are used as functions, tuples unpacked side by side, and
parameters packed.
"""

import json
import re
import subprocess
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TESTS = re.compile(r"(^|/)(\w+_tests?|tests?|testutil|testing|test_scene)\.rs$|/testkit/stream\.rs$|/tests/|/examples/")
TEST_MODULE = re.compile(r"#\[cfg\(test\)\]\s*(?:pub(?:\(\w+\))? )?mod \w+ \{.*\Z", re.S)
IDIOMS = {
    "closures used as functions": re.compile(r"^\s*let (?:mut )?\w+ = (?:move )?\|", re.M),
    "tuples unpacked side by side": re.compile(r"^\s*let \((?:mut )?\w+, (?:mut )?\w+[^)=]*\) =\s*\(", re.M),
    "arrays unpacked from a map": re.compile(r"^\s*let \[[^\]=]*\] =\s*\[[^;]*?\]\s*\.map\(", re.M),
    "packed parameters": re.compile(r"\bfn \w+[^{;]*?[(,]\s*[(\[]\w+[^)\]]*[)\]]: ", re.S),
}
FUNCTION = re.compile(r"^( *)(?:pub(?:\([^)]*\))? )?(?:const |unsafe |async )*fn (\w+)", re.M)


def code(path):
    """The lines of a file that are code and no test."""
    if TESTS.search(str(path)):
        return []
    text = TEST_MODULE.sub("", path.read_text())
    return [line for line in text.splitlines() if line.strip() and not line.strip().startswith("//")]


def long_functions(lines):
    """Names of functions whose bodies have more than 60 lines of code."""
    text = "\n".join(lines)
    for match in FUNCTION.finditer(text):
        end = text.find(f"\n{match[1]}}}", match.end())
        if end > 0 and text.count("\n", match.start(), end) > 60:
            yield match[2]


def room(path):
    parts = path.relative_to(ROOT).parts
    if parts[0] == "crates":
        return "/".join(parts[:2])
    return f"src/{parts[1].removesuffix('.rs')}"


def shipped():
    """The packages of a release, and the crates of ours that each is built from."""
    command = ["cargo", "metadata", "--format-version", "1", "--no-deps"]
    members = json.loads(subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout)["packages"]
    uses = {one["name"]: {d["name"] for d in one["dependencies"] if d["kind"] != "dev"} for one in members}
    release = (ROOT / ".ci/release").read_text()
    for package in re.search(r"^for package in (.*); do$", release, re.M)[1].split():
        crates, more = set(), {package}
        while more:
            crates |= more
            more = {name for crate in more for name in uses[crate] if name in uses} - crates
        yield package, crates


rooms, idioms, long = {}, dict.fromkeys(IDIOMS, 0), []
for folder in ("src", "crates"):
    for path in sorted((ROOT / folder).rglob("*.rs")):
        lines = code(path)
        rooms[room(path)] = rooms.get(room(path), 0) + len(lines)
        long += [f"{path.relative_to(ROOT)}: {name}" for name in long_functions(lines)]
        for name, pattern in IDIOMS.items():
            idioms[name] += len(pattern.findall("\n".join(lines)))

for name, count in sorted(rooms.items(), key=lambda one: -one[1]):
    print(f"{count:6} {name}")
print(f"{sum(rooms.values()):6} all\n")
for package, crates in shipped():
    folders = {"src" if crate == "sweepd" else f"crates/{crate}" for crate in crates}
    lines = sum(n for name, n in rooms.items() if name in folders or name.split("/")[0] in folders)
    print(f"{lines:6} built for the package {package}")
print()
for name, count in idioms.items():
    print(f"{count:6} {name}")
print(f"{len(long):6} functions of more than 60 lines")
for name in long:
    print(f"       {name}")
