"""Wavefront OBJ files: every face in the file's order, with the material that stood above it.

This reader is our own because trimesh's, which serves every other format, cannot keep these promises (5.2.0): it
returns one mesh per material, so that the file's order is lost, and of a file of quads first all first halves; it
takes negative indices from the end of the file instead of from the line that they stand on; it reads an index of 0
as 1; it drops all texture coordinates when one of their indices is out of range; and it stumbles over a comment
after a face.
"""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from fovden.tracer.formats.image_files import ImageFiles
from fovden.tracer.formats.mtl import MtlMaterial, logical_lines, read_mtl, read_text
from fovden.tracer.formats.scene_file import (
    DEFAULT_ALBEDO,
    Floats,
    Integers,
    SceneFileError,
    SceneParts,
    fans,
)
from fovden.tracer.materials import Material

__all__ = ["read_obj"]

# Statements that say nothing about surfaces of polygons: names, groups, points, lines, display hints.
_SILENT = {"g", "o", "s", "l", "p", "mg", "lod", "bevel", "c_interp", "d_interp", "usemap", "maplib", "vp"}


def read_obj(path: Path) -> SceneParts:
    r"""Returns the parts of an OBJ file.

    Polygons become fans around their first corner, in place (exact for convex ones). Indices may be negative, lines
    may be continued by a backslash, and texture coordinates and normals may be missing. The first rows of
    ``vertices`` are the file's ``v`` lines in their order. A row has one texture coordinate and one normal, those of
    its first use by a face; a ``v`` that faces use with others as well is repeated for each further combination, in
    the order of first use, after all the ``v`` lines. Colours after a ``v`` and fourth coordinates are ignored.

    Faces above the first ``usemtl`` have a material named "default" with ``DEFAULT_ALBEDO``, and so has every
    material if the file names no library at all (with a warning). If it names one, that file and the materials that
    are used must be there.

    Args:
        path: The file.

    Returns:
        The parts. The time is about 2 s for 840,000 lines.

    Raises:
        FileNotFoundError: If a material library or an image is not there (the latter from ``material``).
        SceneFileError: If a line cannot be understood or refers to what does not exist; the message has its number.

    Warns:
        UserWarning: If a statement is unknown (once, naming the first), or materials are named but no library.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = Path(folder, "square.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1")
        ...     read_obj(Path(folder, "square.obj")).faces
        array([[0, 1, 2],
               [0, 2, 3]])
    """
    lines = logical_lines(read_text(path))
    data: dict[str, list[str]] = {"v": [], "vt": [], "vn": []}
    polygons: list[str] = []
    polygon_sizes: list[int] = []
    polygon_lines: list[int] = []
    groups: list[tuple[int, int, str | None]] = [(0, 0, None)]  # first polygon, line, material
    libraries: list[tuple[int, str]] = []
    unknown: tuple[int, str] | None = None
    for number, line in enumerate(lines, 1):
        words = line.split(None, 1)
        if not words:
            continue
        key = words[0]
        text = words[1] if len(words) > 1 else ""
        if key in data:
            data[key].append(text)
        elif key == "f":
            if "#" in text:
                text = text.split("#", 1)[0]
            corners = text.split()
            if len(corners) < 3:
                raise SceneFileError(f"{path}:{number}: expected a face of at least 3 corners, got '{line}'")
            if "-" in text:
                counts = len(data["v"]), len(data["vt"]), len(data["vn"])
                corners = [_absolute(corner, counts) for corner in corners]
                text = " ".join(corners)
            polygons.append(text)
            polygon_sizes.append(len(corners))
            polygon_lines.append(number)
        elif key == "usemtl":
            groups.append((len(polygons), number, text.strip() or None))
        elif key == "mtllib":
            libraries.append((number, text.strip()))
        elif unknown is None and key not in _SILENT and not key.startswith("#"):
            unknown = number, key
    if unknown:
        warnings.warn(f"{path}:{unknown[0]}: the unknown statement '{unknown[1]}' is ignored", stacklevel=4)
    positions, texcoords, normals = (_numbers(path, lines, key, rows) for key, rows in data.items())

    sizes = np.array(polygon_sizes, dtype=np.int64)
    tokens = " ".join(polygons).split()
    table = {token: i for i, token in enumerate(dict.fromkeys(tokens))}
    corners_to_table = np.fromiter(map(table.__getitem__, tokens), np.int64, len(tokens))
    references = np.array([_reference(token) for token in table], dtype=np.int64).reshape(-1, 3)
    lengths = np.array([len(positions), len(texcoords), len(normals)])
    broken = np.any((references > lengths) | (references < [1, 0, 0]), axis=1)
    if broken.any():
        corner = int(np.flatnonzero(broken[corners_to_table])[0])
        number = polygon_lines[int(np.searchsorted(np.cumsum(sizes), corner, side="right"))]
        present = ", ".join(f"{n} {key}" for n, key in zip(lengths, data, strict=True))
        raise SceneFileError(
            f"{path}:{number}: '{lines[number - 1].strip()}' refers to what is not there (the file has {present})"
        )
    rows, vertices, uv, shading = _split(references - 1, positions, texcoords, normals)
    triangles, owners = fans(sizes)
    starts, group_lines, used = zip(*groups, strict=True)
    keys = list(dict.fromkeys(used))
    per_polygon = np.repeat([keys.index(key) for key in used], np.diff([*starts, len(polygons)]))
    return SceneParts(
        vertices=vertices,
        faces=rows[corners_to_table[triangles]],
        material_ids=per_polygon[owners],
        names=tuple(key or "default" for key in keys),
        material=_materials(path, libraries, [(key, group_lines[used.index(key)]) for key in keys]),
        normals=shading,
        uv=uv,
    )


def _numbers(path: Path, lines: Sequence[str], key: str, texts: Sequence[str]) -> Floats:
    """The numbers of all statements of one kind, shape (n, 3), or (n, 2) for ``vt``."""
    width = 2 if key == "vt" else 3
    least = 1 if key == "vt" else 3
    try:
        if any(len(text.split()) != width for text in texts):
            texts = [" ".join(_row(text, least, width)) for text in texts]
        flat = np.fromiter(map(float, " ".join(texts).split()), np.float64, len(texts) * width)
        if np.isfinite(flat).all():
            return flat.reshape(-1, width)
    except ValueError:
        pass
    for number, line in enumerate(lines, 1):  # the same again, slowly, to find the line
        words = line.split(None, 1)
        if words and words[0] == key:
            try:
                finite = all(math.isfinite(float(word)) for word in _row("".join(words[1:]), least, width))
            except ValueError:
                finite = False
            if not finite:
                raise SceneFileError(f"{path}:{number}: expected {least} finite numbers, got '{line.strip()}'")
    return _numbers(path, lines, key, [" ".join(_row(text, least, width)) for text in texts])


def _row(text: str, least: int, width: int) -> list[str]:
    """The first words of a statement, without a comment; zeros for optional ones."""
    words = text.split("#", 1)[0].split()
    if len(words) < least:
        raise ValueError(text)
    return (words + ["0"] * width)[:width]


def _absolute(corner: str, counts: tuple[int, ...]) -> str:
    """A corner whose negative indices, counted back from the face's line, are replaced by positive ones."""
    fields = corner.split("/")
    for i, (index, count) in enumerate(zip(fields, counts, strict=False)):
        if index.startswith("-") and index[1:].isdecimal():
            fields[i] = str(max(count + 1 + int(index), 0))
    return "/".join(fields)


def _reference(token: str) -> tuple[int, int, int]:
    """Numbers of v, vt and vn, counted from 1; 0 for what is left out, -1 for what cannot be meant."""
    fields = token.split("/")
    if len(fields) > 3:
        return -1, -1, -1
    v, vt, vn = (
        int(field) if field.isdecimal() and len(field) < 18 and int(field) > 0 else 0 if field == "" else -1
        for field in [*fields, "", ""][:3]
    )
    return v, vt, vn


def _split(
    references: Integers, positions: Floats, texcoords: Floats, normals: Floats
) -> tuple[Integers, Floats, Floats | None, Floats | None]:
    """The vertex row of each distinct corner, and the rows' positions, texture coordinates and normals."""
    v, vt, vn = references.T
    _, first = np.unique(v, return_index=True)
    again = np.ones(len(v), dtype=bool)
    again[first] = False
    rows = v.copy()
    rows[again] = len(positions) + np.arange(again.sum())
    vertices = np.concatenate([positions, positions[v[again]]])
    uv, shading = np.full((len(vertices), 2), np.nan), np.zeros((len(vertices), 3))
    uv[rows[vt >= 0]] = texcoords[vt[vt >= 0]]
    shading[rows[vn >= 0]] = normals[vn[vn >= 0]]
    return rows, vertices, uv if len(texcoords) else None, shading if len(normals) else None


def _materials(
    path: Path, libraries: Sequence[tuple[int, str]], uses: Sequence[tuple[str | None, int]]
) -> Callable[[int], Material]:
    """The function that makes the material of an index; it reads the libraries once and each image once.

    ``uses`` holds each material's name (``None`` above the first ``usemtl``) and the line that first names it.
    """
    files = ImageFiles()

    @functools.cache
    def library() -> dict[str, MtlMaterial]:
        found: dict[str, MtlMaterial] = {}
        for line, text in libraries:
            for file in _library_files(path, line, text):
                found.update(read_mtl(file))
        return found

    def make(index: int) -> Material:
        name, line = uses[index]
        if name is None:
            return Material("default", DEFAULT_ALBEDO)
        if not libraries:
            warnings.warn(f"{path}:{line}: the file names no material library; '{name}' is grey", stacklevel=3)
            return Material(name, DEFAULT_ALBEDO)
        if name not in library():
            listed = ", ".join(text for _, text in libraries)
            raise SceneFileError(f"{path}:{line}: the material '{name}' is not defined in {listed}")
        return library()[name].material(files)

    return make


def _library_files(path: Path, line: int, text: str) -> list[Path]:
    """The files of one ``mtllib`` statement: one name with spaces, or several names."""
    whole = path.parent / text
    if text and whole.is_file():
        return [whole]
    files = [path.parent / word for word in text.split()]
    missing = [file for file in files if not file.is_file()]
    if missing or not files:
        raise FileNotFoundError(f"{path}:{line}: the material library '{text}' is not there ({whole})")
    return files
