"""Reads a PNG file's chunks by the letter of its specification."""

import zlib

SIGNATURE = b"\x89PNG\r\n\x1a\n"


def chunks(data: bytes) -> list[tuple[str, bytes]]:
    """Names and contents of a file's chunks in order, with their checksums verified."""
    assert data.startswith(SIGNATURE)
    found, place = [], len(SIGNATURE)
    while place < len(data):
        length = int.from_bytes(data[place : place + 4], "big")
        name, content = data[place + 4 : place + 8], data[place + 8 : place + 8 + length]
        checksum = data[place + 8 + length : place + 12 + length]
        assert zlib.crc32(name + content) == int.from_bytes(checksum, "big")
        found.append((name.decode("ascii"), content))
        place += 12 + length
    return found
