"""Wavefront material libraries: exact floats, images, and one clear message for everything that is lost.

trimesh's own reader rounds colours to eight bits and drops an image that it cannot find without a word.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from pathlib import Path

from torch import Tensor

from fovden.tracer.formats.image_files import ImageFiles, alpha_of, cut_of, grey_of, visible
from fovden.tracer.formats.scene_file import DEFAULT_ALBEDO, SceneFileError, texture_of
from fovden.tracer.materials import CUTOFF, MODELS, Material

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
    "-imfchan": (1, None),  # matters to map_d alone
    "-mm": (2, (0.0, 1.0)),
    "-texres": (1, None),
    "-type": (1, None),
}
_VECTOR_OPTIONS = {"-o": 0.0, "-s": 1.0, "-t": 0.0}

_PHYSICAL = ("pr", "pm", "map_pr", "map_pm")

NOTE = "#fovden"
"""What :func:`fovden.tracer.formats.obj_writer.write_obj` adds to a material for us alone, a comment to others: pairs
of a name and a value."""


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
        >>> lamp.material(ImageFiles()).albedo
        (0.043014, 0.0, 0.0)
    """

    name: str
    path: Path
    line: int
    statements: dict[str, tuple[int, str]] = field(default_factory=dict)

    def material(self, files: ImageFiles) -> Material:
        """Returns the material that the tracer uses.

        The reflectance is ``Kd``, times the image of ``map_Kd`` where there is one, as the Wavefront specification
        demands. Without ``Kd`` the factor of an image is 1 and a plain reflectance ``DEFAULT_ALBEDO``. ``Ke`` is
        the emitted radiance. With any of ``Pr``, ``Pm``, ``map_Pr`` and ``map_Pm`` (roughness and metallic, factors
        and images of them; 1 and 0 by default, 1 for images) the material is ``"metallic_roughness"``, otherwise
        Lambertian. ``map_d`` cuts holes where the opacity is below 0.5: the channel that ``-imfchan`` names; without,
        alpha if it says anything, or else luma. ``d`` is its factor; by itself, the same all over, it cuts nothing,
        since programs disagree whether 0 or 1 is clear. Everything else (``Ks``, ``map_Bump``, ...) is ignored.

        Args:
            files: Where images come from.

        Returns:
            The material.

        Raises:
            FileNotFoundError: If an image is not there.
            SceneFileError: If a statement has no usable values or an image cannot be decoded.

        Warns:
            UserWarning: If an option of a map changes the image's place or values, which is not supported, or if
                there is a ``map_Ke``: only ``Ke`` is used.

        Example:
            >>> MtlMaterial("plain", Path("a.mtl"), 1).material(ImageFiles()).albedo
            (0.5, 0.5, 0.5)
        """
        image = self._image("map_kd")
        texture = None if image is None else self._read(files, "map_kd", image)
        albedo = self._colour("kd", maximum=1) or (DEFAULT_ALBEDO if texture is None else (1.0, 1.0, 1.0))
        emission = self._colour("ke") or (0.0, 0.0, 0.0)
        if "map_ke" in self.statements:
            self._warn("map_ke", "the image is not used, only Ke is")
        note = self._note()
        physical = any(key in self.statements for key in _PHYSICAL)
        rough, metal = self._image("map_pr"), self._image("map_pm")
        opacity, cutoff = self._opacity(files, float(note.get("cutoff", CUTOFF)))
        return Material(
            self.name,
            albedo,
            emission,
            texture,
            model=note.get("model", "metallic_roughness" if physical else "lambert"),  # type: ignore[arg-type]
            roughness=float(note.get("roughness", self._number("pr", 1.0))),
            metallic=float(note.get("metallic", self._number("pm", 0.0 if metal is None else 1.0))),
            surface=self._pair(files, rough, metal),
            opacity=opacity,
            cutoff=cutoff,
        )

    def _note(self) -> dict[str, str]:
        """What our own writer added, nothing in files of others."""
        words = self.statements.get(NOTE, (0, ""))[1].split()
        note = dict(zip(words[::2], words[1::2], strict=False))
        if note.get("model", MODELS[0]) not in MODELS:
            raise SceneFileError(self._where(NOTE) + f"expected a model of {', '.join(MODELS)}, got '{note['model']}'")
        return note

    def _opacity(self, files: ImageFiles, cutoff: float) -> tuple[Tensor | None, float]:
        image = self._image("map_d")
        if image is None:
            return None, cutoff
        return visible(self._read(files, "map_d", image), cutoff, self._number("d", 1.0))

    def _pair(self, files: ImageFiles, rough: Path | None, metal: Path | None) -> Tensor | None:
        if rough is None and metal is None:
            return None
        try:
            return files.pair(rough, metal)
        except SceneFileError as error:
            raise SceneFileError(self._where("map_pr" if rough is not None else "map_pm") + str(error)) from error

    def _number(self, key: str, default: float) -> float:
        """A number from 0 to 1."""
        if key not in self.statements:
            return default
        found = self._colour(key, maximum=1)
        return default if found is None else found[0]

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

    def _image(self, key: str) -> Path | None:
        """The image file that a map statement names."""
        if key not in self.statements:
            return None
        name = self._skip_options(key)
        candidates = [self.path.parent / name, self.path.parent / name.replace("\\", "/")]
        path = next((candidate for candidate in candidates if _is_file(candidate)), None)
        if path is None:
            raise FileNotFoundError(self._where(key) + f"the image '{name}' is not there ({candidates[-1]})")
        return path.resolve()

    def _read(self, files: ImageFiles, key: str, path: Path) -> Tensor:
        words = self.statements[key][1].split()
        channel = words[words.index("-imfchan") + 1] if "-imfchan" in words[:-1] else ""
        convert = {"m": alpha_of, "l": grey_of}.get(channel, cut_of) if key == "map_d" else texture_of
        try:
            return files.read(path, convert)
        except SceneFileError as error:
            raise SceneFileError(self._where(key) + str(error)) from error

    def _skip_options(self, key: str) -> str:
        """The file name after a map statement's options; a warning for those that are not neutral."""
        text = rest = self.statements[key][1]
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
                raise SceneFileError(self._where(key) + f"unknown option '{option}' in '{text}'")
            values = words[1 : 1 + count]
            if isinstance(neutral, tuple):
                harmless = [float(value) if _is_number(value) else None for value in values] == list(neutral)
            else:
                harmless = neutral is None or values == [neutral]
            if not harmless:
                self._warn(key, f"the option '{' '.join([option, *values])}' is ignored")
            rest = [*rest.split(None, 1 + count), *[""] * (2 + count)][1 + count]
        if not rest:
            raise SceneFileError(self._where(key) + f"'{text}' names no file")
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
        elif current is not None and key and (key == NOTE or not key.startswith("#")):
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
