"""Puts the programs of a release and its library into the wheel, so that `pip install` gives the commands, too."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PROGRAMS = ("sweepd", "sweepd-view", "sweepd-lab", "sweepd-db3")
LIBRARY = "libsweepd.so"
NOTICES = "copyright"
# Machines by `e_machine` of an ELF header, which is in bytes 18 and 19.
MACHINES = {62: "x86_64", 183: "aarch64"}


class Programs(BuildHookInterface[Any]):
    """Takes them from the folder SWEEPD_PROGRAMS, a whole path, else from target/release of a checkout where all are.

    Without them the wheel is pure Python, for any machine: it then needs a `sweepd` and a library that are there.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Say what goes where, and on which machines it runs."""
        given = os.environ.get("SWEEPD_PROGRAMS")
        folder = Path(given or Path(self.root, "../target/release")).absolute()
        # A release has the licences of the crates in its programs, too.
        wanted = (*PROGRAMS, LIBRARY, *((NOTICES,) if given else ()))
        missing = [name for name in wanted if not (folder / name).is_file()]
        if missing and given:
            raise FileNotFoundError(f"SWEEPD_PROGRAMS: {folder} has no {', '.join(missing)}")
        if missing or version == "editable":
            return
        machine = MACHINES[int.from_bytes((folder / LIBRARY).read_bytes()[18:20], "little")]
        # The release asks auditwheel for the oldest C library that runs them, and names that instead.
        build_data.update(pure_python=False, tag=f"py3-none-linux_{machine}")
        build_data["shared_scripts"] = {str(folder / name): name for name in PROGRAMS}
        build_data["force_include"][str(folder / LIBRARY)] = f"sweepd/{LIBRARY}"
        if given:
            build_data["force_include"][str(folder / NOTICES)] = f"sweepd/{NOTICES}"
