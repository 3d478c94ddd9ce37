"""Wavefront material libraries: exact floats, images, and one clear message for everything that is lost.

trimesh's own reader rounds colours to eight bits and drops an image that it cannot find without a word.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from torch import Tensor

from fovden.tracer.formats.scene_file import DEFAULT_ALBEDO, SceneFileError
from fovden.tracer.materials import Material

__all__ = ["MtlMaterial", "logical_lines", "read_mtl"]

Triple = tuple[float, float, float]

# Number of values of each option of a map statement (Wavefront MTL specification, "Texture map options"), and
# the values that change nothing, or nothing that a base colour shows.
_FIXED_OPTIONS: dict[str, tuple[int, tuple[float, ...] | str | None]] = {
    "-blendu": (1, None),
    "-blendv": (1, None),
    "-bm": (1, None),
    "-boost": (1, None),
    "-cc": (1, "off"),
    "-clamp": (1, "off"),
    "-imfchan": (1, None),
    "-mm": (2, (0.0, 1.0)),
    "-texres": (1, None),
    "-type": (1, None),
}
_VECTOR_OPTIONS = {"-o": 0.0, "-s": 1.0, "-t": 0.0}


def logical_lines(text: str) -> list[str]:
    r"""Returns the lines of a Wavefront file, the line of number i at index i - 1.

    Line ends may be those of any system. A line that ends in a backslash is joined with the next one; empty lines
    keep the numbering.

    Args:
        text: The file's content.

    Returns:
        The lines, without their ends.

    Example:
        >>> logical_lines("f 1 2 \\\r\n 3\r\nf 2 3 1")
        ['f 1 2   3', '', 'f 2 3 1']
    """
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if "\\\n" in text or "\\\r" in text:
        for i in range(len(lines) - 2, -1, -1):
            if lines[i].endswith("\\"):
                lines[i], lines[i + 1] = f"{lines[i][:-1]} {lines[i + 1]}", ""
    return lines


def read_text(path: Path) -> str:
    """Returns a text file's content: UTF-8, or Latin-1 where it is no UTF-8, which decodes anything."""
    data = path.read_bytes()
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


@dataclass(frozen=True)
class MtlMaterial:
    """One material of a library, its statements not yet interpreted.

    Attributes:
        name: Name after ``newmtl``.
        path: The library.
        line: Line of ``newmtl``.
        statements: Line and text of each statement by its keyword in lower case; of repeated ones the last.

    Example:
        >>> lamp = MtlMaterial("lamp", Path("a.mtl"), 1, {"kd": (2, "0.043014 0 0"), "ke": (3, "5 5 5")})
        >>> lamp.material(lambda path: None).albedo
        (0.043014, 0.0, 0.0)
    """

    name: str
    path: Path
    line: int
    statements: dict[str, tuple[int, str]] = field(default_factory=dict)

    def material(self, load: Callable[[Path], Tensor]) -> Material:
        """Returns the material that the tracer uses.

        The reflectance is ``Kd``, times the image of ``map_Kd`` where there is one, as the Wavefront specification
        demands. Without ``Kd`` the factor of an image is 1 and a plain reflectance ``DEFAULT_ALBEDO``. ``Ke`` is
        the emitted radiance. Everything else (``Ks``, ``d``, ``map_d``, ``map_Bump``, ...) has no meaning for an
        opaque Lambertian surface and is ignored.

        Args:
            load: Decodes an image file.

        Returns:
            The material.

        Raises:
            FileNotFoundError: If the image is not there.
            SceneFileError: If a statement has no usable values or the image cannot be decoded.

        Warns:
            UserWarning: If an option of ``map_Kd`` changes the image's place or values, which is not supported, or
                if there is a ``map_Ke``: only ``Ke`` is used.

        Example:
            >>> MtlMaterial("plain", Path("a.mtl"), 1).material(lambda path: None).albedo
            (0.5, 0.5, 0.5)
        """
        texture = self._texture(load)
        albedo = self._colour("kd", maximum=1) or (DEFAULT_ALBEDO if texture is None else (1.0, 1.0, 1.0))
        emission = self._colour("ke") or (0.0, 0.0, 0.0)
        if "map_ke" in self.statements:
            self._warn("map_ke", "the image is not used, only Ke is")
        return Material(self.name, albedo, emission, texture)

    def _colour(self, key: str, maximum: float = math.inf) -> Triple | None:
        if key not in self.statements:
            return None
        text = self.statements[key][1]
        words = text.split("#", 1)[0].split()
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if len(values) == 1:  # the specification: green and blue default to red
            values *= 3
        if len(values) != 3 or not all(0 <= value <= maximum for value in values) or math.inf in values:
            bounds = "at least 0" if maximum == math.inf else f"from 0 to {maximum:g}"
            raise SceneFileError(self._where(key) + f"expected one or three numbers {bounds}, got '{text}'")
        red, green, blue = values
        return red, green, blue

    def _texture(self, load: Callable[[Path], Tensor]) -> Tensor | None:
        if "map_kd" not in self.statements:
            return None
        text = self.statements["map_kd"][1]
        name = self._skip_options(text)
        candidates = [self.path.parent / name, self.path.parent / name.replace("\\", "/")]
        path = next((candidate for candidate in candidates if _is_file(candidate)), None)
        if path is None:
            raise FileNotFoundError(self._where("map_kd") + f"the image '{name}' is not there ({candidates[-1]})")
        try:
            return load(path.resolve())
        except SceneFileError as error:
            raise SceneFileError(self._where("map_kd") + str(error)) from error

    def _skip_options(self, text: str) -> str:
        """The file name after a map statement's options; a warning for those that are not neutral."""
        rest = text
        while rest.startswith("-"):
            words = rest.split()
            option = words[0]
            if option in _FIXED_OPTIONS:
                count, neutral = _FIXED_OPTIONS[option]
            elif option in _VECTOR_OPTIONS:
                numbers = [_is_number(word) for word in words[1:4]]
                count = [*numbers, False].index(False)
                neutral = (_VECTOR_OPTIONS[option],) * count
            else:
                raise SceneFileError(self._where("map_kd") + f"unknown option '{option}' in '{text}'")
            values = words[1 : 1 + count]
            if isinstance(neutral, tuple):
                harmless = [float(value) if _is_number(value) else None for value in values] == list(neutral)
            else:
                harmless = neutral is None or values == [neutral]
            if not harmless:
                self._warn("map_kd", f"the option '{' '.join([option, *values])}' is ignored")
            rest = [*rest.split(None, 1 + count), *[""] * (2 + count)][1 + count]
        if not rest:
            raise SceneFileError(self._where("map_kd") + f"'{text}' names no file")
        return rest

    def _where(self, key: str) -> str:
        line, _ = self.statements[key]
        return f"{self.path}:{line}: material '{self.name}', {key}: "

    def _warn(self, key: str, message: str) -> None:
        warnings.warn(self._where(key) + message, stacklevel=4)


def read_mtl(path: Path) -> dict[str, MtlMaterial]:
    r"""Returns the materials of a library by name; of equal names the last one counts.

    Args:
        path: The library.

    Returns:
        The materials; nothing is interpreted and no image opened until :meth:`MtlMaterial.material`.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     _ = Path(folder, "a.mtl").write_text("newmtl red brick\nKd 0.5 0.1 0.1")
        ...     list(read_mtl(Path(folder, "a.mtl")))
        ['red brick']
    """
    materials: dict[str, MtlMaterial] = {}
    current: MtlMaterial | None = None
    for number, line in enumerate(logical_lines(read_text(path)), 1):
        key, text = [*line.split(None, 1), "", ""][:2]
        if key == "newmtl":
            current = materials[text.strip()] = MtlMaterial(text.strip(), path, number)
        elif current is not None and key and not key.startswith("#"):
            current.statements[key.lower()] = (number, text.strip())
    return materials


def _is_number(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # such as a name that is too long
        return False
