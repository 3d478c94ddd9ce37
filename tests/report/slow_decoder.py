"""The report's format read back, one value at a time, from its description alone."""

import json
import math
import re
import zlib

import numpy as np


def bytes_of(text):
    data, letters = b"", iter(text[1:])
    for letter in letters:
        unit = ord(letter) if letter != "\ue000" else ord(next(letters)) ^ 0x8000
        data += bytes([unit % 256, unit // 256])
    return data[: len(data) - int(text[0])]


def undo_prediction(plane, modulus, known=None):
    """Values from differences, row by row, but where they are known; `plane` and `known` have shape (h, w)."""
    height, width = plane.shape
    for y in range(height):
        for x in range(width):
            if known is not None and known[y, x]:
                continue
            a = int(plane[y, x - 1]) if x else 0
            b = int(plane[y - 1, x]) if y else 0
            c = int(plane[y - 1, x - 1]) if x and y else 0
            prediction = sorted([a, b, a + b - c])[1]
            value = (int(plane[y, x]) + prediction) % modulus
            plane[y, x] = value - modulus if modulus == 65536 and value >= 32768 else value


def codes_of(data, shape, like=None, copied=None):
    """`like` has the codes, shape (v, 3, h, w), that the image copies where `copied`, shape (v, 1, h, w)."""
    views, _, height, width = shape
    known = np.zeros((views, 1, height, width), bool) if copied is None else copied.astype(bool)
    raw = zlib.decompress(data)
    count = 3 * int((~known).sum())
    assert len(raw) == 1 + 2 * count
    numbers = []
    for index in range(count):
        folded = raw[1 + index] + 256 * raw[1 + count + index]
        numbers.append(folded // 2 if folded % 2 == 0 else -(folded + 1) // 2)
    stored = np.zeros((3, views, height, width), np.int64)
    left = iter(numbers)
    for channel, view, y, x in np.ndindex(*stored.shape):
        if known[view, 0, y, x]:
            own = int(like[view, (1, 0, 2)[channel], y, x]) - (int(like[view, 1, y, x]) if channel else 0)
            stored[channel, view, y, x] = (own + 32768) % 65536 - 32768
        else:
            stored[channel, view, y, x] = next(left)
    if raw[0] == 1:
        for channel, view in np.ndindex(3, views):
            undo_prediction(stored[channel, view], 65536, known[view, 0])
    green, red, blue = stored
    codes = np.stack([red + green, green, blue + green], axis=1)
    return (codes + 32768) % 65536 - 32768


def radiance_of(codes, knee, steps):
    shape = codes.shape
    values = np.empty(shape)
    for index in np.ndindex(*shape):
        code = int(codes[index])
        if code == -32768:
            values[index] = math.nan
        elif abs(code) == 32767:
            values[index] = math.copysign(math.inf, code)
        else:
            values[index] = math.copysign(knee * (2 ** (abs(code) / steps) - 1), code)
    return values


def map_of(data, shape):
    raw = zlib.decompress(data)
    values = np.array(list(raw[1:]), np.int64).reshape(shape)
    if raw[0] == 1:
        for plane in values.reshape(-1, *shape[-2:]):
            undo_prediction(plane, 256)
    return values


def images_of(report, data):
    """Radiance of all images of a page that `read_page` has read."""
    shape, decoded = (report["views"], 3, report["height"], report["width"]), []
    for entry in report["images"]:
        like = copied = None
        if entry["like"] is not None:
            like, copied = decoded[entry["like"]], map_of(bytes_of(data[entry["copied"]]), (shape[0], 1, *shape[2:]))
        decoded.append(codes_of(bytes_of(data[entry["data"]]), shape, like, copied))
    return [radiance_of(codes, report["knee"], report["steps"]) for codes in decoded]


def read_page(text):
    """The description of a page and the texts of its data."""
    description = re.search(r'<script type="application/json" id="report">(.*?)</script>', text, re.DOTALL)[1]
    data = dict(re.findall(r'<script type="application/octet-stream" id="([\w-]+)">([^<]*)</script>', text))
    return json.loads(description), data
