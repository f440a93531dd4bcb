"""Sweeps of a capture, by the program `sweepd`."""

from __future__ import annotations

import logging
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any, Union

import numpy as np

from ._library import NAME as LIBRARY
from ._sweep import Sweep
from .layout import HEADER, LayoutError, SweepdError

if TYPE_CHECKING:
    from collections.abc import Iterator

Option = Union[str, float, bool, "os.PathLike[str]", "list[str]"]
LOG = logging.getLogger("sweepd")


def replay(
    capture: str | os.PathLike[str], *, binary: str | os.PathLike[str] | None = None, **options: Option
) -> Iterator[Sweep]:
    """Give the sweeps of a capture, one after the other, none left out; their memory is this program's own, to write to.

    Runs `sweepd replay`, found as `binary`, else as the variable SWEEPD, else in the wheel of this package, else in PATH.
    It ends with the iterator. Each of `options` is an option of that command: `replay("x.pcap", start=10, return_="last",
    partial=True, sensor=["192.168.1.201"])`. What it notes goes to the log `sweepd`. Raises `SweepdError` with what it says
    when it fails, after the sweeps that came before; also of a capture that has no whole turn, unless `partial` is given.
    """
    command = [_program(binary), "replay", "--raw=-", *_arguments(options), "--", os.fspath(capture)]
    with tempfile.TemporaryFile() as said:
        try:
            # Ctrl-C in a terminal is this program's alone, which ends the other.
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=said, start_new_session=True
            )
        except OSError as error:
            raise SweepdError(f"cannot run {command[0]}: {error.strerror}") from error
        with child:
            try:
                while (sweep := _next(child.stdout)) is not None:
                    yield sweep
            except BaseException:
                # The caller has enough, or these are no sweeps.
                child.kill()
                child.wait()
                raise
        said.seek(0)
        text = said.read().decode(errors="replace").strip()
        if child.returncode != 0:
            # The cure, in this language.
            text = text.replace("--partial gives", "`partial=True` gives")
            raise SweepdError(text or f"{command[0]} ended with code {child.returncode}")
        for line in text.splitlines():
            LOG.log(logging.WARNING if line.startswith("warning") else logging.INFO, "%s", line)


def _program(binary: str | os.PathLike[str] | None) -> str:
    program = binary or os.environ.get("SWEEPD") or _of_wheel() or shutil.which("sweepd")
    if program is None:
        raise SweepdError(
            "no program `sweepd` in PATH, nor in this package: install a wheel of sweepd that is made for this machine, "
            "name the program in the variable SWEEPD, or give `binary`"
        )
    return os.fspath(program)


def _of_wheel() -> str | None:
    """The program that came with this package: PATH has not that of a venv that is not activated."""
    package = Path(__file__).parent
    # A wheel has both or none, and `pip --target` has a bin beside its packages.
    if (package / LIBRARY).exists():
        for folder in (package.parent, Path(sys.prefix)):
            program = folder / "bin/sweepd"
            if program.is_file() and os.access(program, os.X_OK):
                return str(program)
    return None


def _arguments(options: dict[str, Any]) -> list[str]:
    """The options as arguments; `return_` is `--return`, a word of Python."""
    arguments = []
    for name, value in options.items():
        option = "--" + name.rstrip("_").replace("_", "-")
        values = value if isinstance(value, list) else [value]
        for one in values:
            if one is True:
                arguments.append(option)
            elif one is not False:
                arguments.append(f"{option}={one}")
    return arguments


def _next(output: Any) -> Sweep | None:
    """The next sweep of a stream; `None` at its end."""
    start = output.read(HEADER.itemsize)
    if not start:
        return None
    if len(start) < HEADER.itemsize:
        raise LayoutError(f"a sweep is cut short after {len(start)} bytes")
    # How many there are is checked with the rest.
    total_bytes = int(np.frombuffer(start, HEADER)[0]["total_bytes"])
    data = np.empty(max(HEADER.itemsize, min(total_bytes, 1 << 32)), np.uint8)
    data[: HEADER.itemsize] = np.frombuffer(start, np.uint8)
    read = output.readinto(data[HEADER.itemsize :])
    return Sweep(data[: HEADER.itemsize + read])
