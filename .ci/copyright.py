#!/usr/bin/env python3
"""Prints the copyright file of the Debian packages: the licence of sweepd, and those of all crates in its programs, with
their texts from the crates' own sources. A text that several crates have is printed once."""

import json
import subprocess
import sys
from pathlib import Path

PROGRAMS = ["sweepd", "sweepd-ros2", "sweepd-tools", "sweepd-c"]
# Licence files at the top of a crate, by the beginnings of their names.
NAMES = ("license", "licence", "copying", "copyright", "notice", "unlicense")


def cargo(*words):
    return subprocess.run(["cargo", *words, "--locked"], check=True, capture_output=True, text=True).stdout


def linked():
    """Names and versions of the crates in the programs, those that only build them left out."""
    programs = [word for name in PROGRAMS for word in ("-p", name)]
    tree = cargo("tree", "-e", "normal,no-proc-macro", "--prefix", "none", "--no-dedupe", "-f", "{p}", *programs)
    return {tuple(line.split()[:2]) for line in tree.splitlines() if line}


def texts(folder):
    """The licence files of a crate."""
    files = sorted(file for file in folder.iterdir() if file.is_file() and file.name.lower().startswith(NAMES))
    return [file.read_text(errors="replace").strip() for file in files]


def main():
    in_programs = linked()
    crates = [
        package
        for package in json.loads(cargo("metadata", "--format-version", "1"))["packages"]
        if (package["name"], "v" + package["version"]) in in_programs and package["source"]
    ]
    # By the words of a text: crates break its lines differently.
    users, shown, without = {}, {}, []
    for package in crates:
        found = texts(Path(package["manifest_path"]).parent)
        name = f"{package['name']} {package['version']}"
        if not package["license"] and not found:
            sys.exit(f"copyright.py: {name} has no licence")
        if not found:
            without.append(package)
        for text in found:
            words = " ".join(text.split())
            users.setdefault(words, []).append(name)
            shown.setdefault(words, text)

    print("sweepd: MIT or Apache-2.0, at your choice.\n")
    print(Path("LICENSE-MIT").read_text())
    print("On Debian, the Apache License 2.0 is in /usr/share/common-licenses/Apache-2.0.\n")
    print("The programs contain these crates:\n")
    for package in crates:
        authors = ", ".join(package["authors"])
        print(f"  {package['name']} {package['version']}: {package['license'] or 'see below'}" + f" ({authors})" * bool(authors))
    print("\nThe standard library of Rust is MIT OR Apache-2.0 (The Rust Project contributors), SQLite is in the public domain.")
    if without:
        print("\nOf these the sources have no text; that of another crate below with the same licence holds:\n")
        for package in without:
            print(f"  {package['name']} {package['version']}: {package['license']}")
    for words, names in users.items():
        print(f"\n{'-' * 100}\n{', '.join(names)}\n\n{shown[words]}")


main()
