"""How objects of this package show themselves: on a line, and in a notebook."""

from __future__ import annotations

import base64
import datetime
import html
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

# What is as far or farther is black, metres.
FAR_M = 100.0


def time(time_ns: Any) -> str:
    """Give a time in words, to the millisecond."""
    at = datetime.datetime.fromtimestamp(int(time_ns) // 10**6 / 1000, datetime.timezone.utc)
    return at.isoformat(timespec="milliseconds").replace("+00:00", "Z")


def one_line(told: dict[str, str]) -> str:
    """Give what is said, on a line."""
    return ", ".join(f"{name} {value}" for name, value in told.items())


def table(title: str, told: dict[str, str]) -> str:
    """Give what is said, as a table of HTML."""
    rows = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(value)}</td></tr>" for name, value in told.items())
    return f"<table><caption>sweepd.{title}</caption>{rows}</table>"


def picture(range_m: NDArray[np.float32]) -> str:
    """Give a picture of ranges, (columns, rows) metres: near ones are bright, pixels without a return are black."""
    nearness = 1 - np.log1p(range_m.T.clip(0, FAR_M)) / np.log1p(FAR_M)
    gray = np.where(range_m.T > 0, 255 * nearness, 0).astype(np.uint8)
    rows, columns = gray.shape
    # Each row of a PNG begins with its filter: none.
    pixels = zlib.compress(np.pad(gray, ((0, 0), (1, 0))).tobytes(), 1)
    header = struct.pack(">IIBBBBB", columns, rows, 8, 0, 0, 0, 0)
    chunks = b"".join(_chunk(kind, body) for kind, body in ((b"IHDR", header), (b"IDAT", pixels), (b"IEND", b"")))
    data = base64.b64encode(b"\x89PNG\r\n\x1a\n" + chunks).decode()
    style = f"width: 100%; height: {max(64, 2 * rows)}px; image-rendering: pixelated"
    return f'<img alt="ranges" style="{style}" src="data:image/png;base64,{data}">'


def _chunk(kind: bytes, body: bytes) -> bytes:
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))
