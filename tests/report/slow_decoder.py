"""The report's format read back, one value at a time, from its description alone."""

import json
import math
import re
import zlib

import numpy as np


def bytes_of(text):
    filling, letters = int(text[0]), text[1:]
    digits = [ord(letter) - (35 if ord(letter) < 60 else 36) for letter in letters]
    data = b""
    for start in range(0, len(digits), 5):
        word = 0
        for digit in digits[start : start + 5]:
            word = word * 85 + digit
        data += word.to_bytes(4, "big")
    return data[: len(data) - filling]


def undo_prediction(plane, modulus):
    """Values from differences, row by row; `plane` has shape (h, w)."""
    height, width = plane.shape
    for y in range(height):
        for x in range(width):
            a = int(plane[y, x - 1]) if x else 0
            b = int(plane[y - 1, x]) if y else 0
            c = int(plane[y - 1, x - 1]) if x and y else 0
            prediction = sorted([a, b, a + b - c])[1]
            value = (int(plane[y, x]) + prediction) % modulus
            plane[y, x] = value - modulus if modulus == 65536 and value >= 32768 else value


def codes_of(data, shape):
    views, channels, height, width = shape
    raw = zlib.decompress(data)
    count = views * channels * height * width
    assert len(raw) == 1 + 2 * count
    stored = np.zeros(count, np.int64)
    for index in range(count):
        folded = raw[1 + index] + 256 * raw[1 + count + index]
        stored[index] = folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
    stored = stored.reshape(channels, views, height, width)
    if raw[0] == 1:
        for plane in stored.reshape(-1, height, width):
            undo_prediction(plane, 65536)
    green, red, blue = stored
    codes = np.stack([red + green, green, blue + green], axis=1)
    return (codes + 32768) % 65536 - 32768


def radiance_of(data, shape, knee, steps):
    values = np.empty(shape)
    codes = codes_of(data, shape)
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


def read_page(text):
    """The description of a page and the texts of its data."""
    description = re.search(r'<script type="application/json" id="report">(.*?)</script>', text, re.DOTALL)[1]
    data = dict(re.findall(r'<script type="application/octet-stream" id="([\w-]+)">([^<]*)</script>', text))
    return json.loads(description), data
