"""The layout of an OpenEXR file, as far as needed to see whether all of it is there."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import BinaryIO

from fovden.checks import require

__all__ = ["require_whole"]

MAGIC = b"\x76\x2f\x31\x01"  # OpenEXR file layout, "Magic number"
TILED, DEEP, MULTIPART = 0x200, 0x800, 0x1000  # the same document, "Version field"


def require_whole(path: Path) -> None:
    """Raises unless the file is an OpenEXR file that ends no earlier than its table of contents says.

    OpenEXR itself prints to the terminal at a file that was cut short, and goes on.

    Args:
        path: The file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is another kind of file, has deep pixels, or is not all there.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "text.exr"
        >>> _ = path.write_text("not an image")
        >>> require_whole(path)
        Traceback (most recent call last):
        ...
        ValueError: ...text.exr: expected an OpenEXR file, got one that starts with b'not '
    """
    if path.is_dir() or not path.exists():
        raise FileNotFoundError(f"{path}: {'a folder, not a file' if path.is_dir() else 'no such file'}")
    with path.open("rb") as file:
        magic = file.read(4)
        require(magic == MAGIC, str(path), f"one that starts with {magic!r}", "an OpenEXR file")
        try:
            end = _expected_end(file)
        except (struct.error, ValueError) as error:
            raise ValueError(f"{path}: this OpenEXR file is cut short or damaged ({error})") from None
    size = path.stat().st_size
    require(size >= end, str(path), f"{size} bytes", f"at least {end}: this OpenEXR file is cut short or damaged")


def _expected_end(file: BinaryIO) -> int:
    """Offset at which the last block of pixels ends, from the headers and the table of offsets.

    The table lists where each block starts, and the first block follows right behind it.
    """
    (flags,) = struct.unpack("<i", file.read(4))
    require(not flags & DEEP, "samples", "deep ones", "one value per pixel")
    kinds = [_skip_header(file)]
    if flags & MULTIPART:
        while kinds[-1] is not None:
            kinds.append(_skip_header(file))
        kinds.pop()
    first = last = 0
    while not first or file.tell() < first:
        (offset,) = struct.unpack("<Q", file.read(8))
        require(
            offset >= file.tell(), "offset of a block", offset, "one behind the table (the file was never finished)"
        )
        first, last = min(first or offset, offset), max(last, offset)
    file.seek(last)
    part = struct.unpack("<i", file.read(4))[0] if flags & MULTIPART else 0
    require(0 <= part < len(kinds), "part of a block", part, f"0 to {len(kinds) - 1}")
    tiled = bool(flags & TILED) if not flags & MULTIPART else kinds[part] == b"tiledimage"
    *_, size = struct.unpack("<5i" if tiled else "<2i", file.read(20 if tiled else 8))
    return file.tell() + int(size)


def _skip_header(file: BinaryIO) -> bytes | None:
    """Reads the attributes of one part; returns its type (empty if not told), or ``None`` at the list's end."""
    kind: bytes | None = None
    while name := _read_text(file):
        kind = kind or b""
        attribute = _read_text(file)
        (size,) = struct.unpack("<i", file.read(4))
        require(size >= 0, "size of an attribute", size, "at least 0")
        value = file.read(size)
        if (name, attribute) == (b"type", b"string"):
            kind = value
    return kind


def _read_text(file: BinaryIO) -> bytes:
    text = bytearray()
    while (letter := file.read(1)) != b"\0":
        require(len(letter) == 1 and len(text) < 256, "name", bytes(text), "one that ends")
        text += letter
    return bytes(text)
