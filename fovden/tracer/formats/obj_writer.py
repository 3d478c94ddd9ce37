"""Wavefront OBJ, written: geometry and materials; what OBJ cannot hold goes into a JSON file beside it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from fovden.camera import StereoCamera
from fovden.checks import require
from fovden.io.files import FilePath, atomic_write
from fovden.tracer.formats.mtl import NOTE
from fovden.tracer.formats.surfaces import (
    Surfaces,
    environment_entry,
    gather_surfaces,
    png_bytes,
    save_environment,
    shortest,
    split_lights,
)
from fovden.tracer.lights import PointLight
from fovden.tracer.materials import CUTOFF, MODELS, Materials

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene

__all__ = ["write_obj"]

BLOCK = 1 << 15
"""Lines that are formatted at once: enough that a line's share of the overhead is small, little enough memory."""

Json = dict[str, Any]
Booleans = npt.NDArray[np.bool_]


def write_obj(path: FilePath, scene: Scene) -> list[Path]:
    r"""Writes a scene to an OBJ file, with a material library, images and a JSON file beside it.

    ``v`` lines are the scene's vertices in their order, ``vt`` and ``vn`` those that are used, with nine digits, which
    give a float32 back. Faces are sorted by material in the order of the materials' first triangles, one ``usemtl``
    each, and otherwise keep their order. Corners whose normal is a row of zeros have no ``vn`` (only in a triangle
    with both kinds, which the format does not have, they get the triangle's own normal); texture coordinates are left
    out where a material's are all zero and it has no image.

    In the library ``Kd`` is the linear reflectance, which multiplies the image of ``map_Kd`` (PNG with the sRGB curve),
    and ``Ke`` the radiance in W/(m^2 sr), emitted on the side of the geometric normal. ``Pr`` and ``Pm`` are roughness
    and metallic, which multiply the images of ``map_Pr`` and ``map_Pm``; diffuse surfaces have none. ``map_d`` is the
    opacity. A comment ``#fovden`` tells our own reader what has no statement: other models, and cutoffs. Other programs
    end a name at white space and take one name for one material; so names are written with ``_`` for anything but
    letters, digits and ``.+-``, and a number is added to a name that is taken.

    The JSON file has ``camera`` and ``views`` (eye, target and up; both fields of view; height and width of one eye's
    image; for each eye, left first, ``camera_to_world``, a 4 x 4 matrix in rows that takes (right, up, backward), and
    ``bounds``, the tangents of the image's edges: left, right, bottom, top), ``lights`` (position in metres and
    intensity in W/sr; direction in which the light travels and irradiance in W/m^2; radiance in W/(m^2 sr) or an
    OpenEXR file), and each material's ``names`` here and in the library. The camera path is left out.

    Args:
        path: The file, named ``*.obj``; its folder must exist. ``x.obj`` comes with ``x.mtl``, ``x.json``,
            ``x_texture0.png``, ``x_opacity0.png``, ``x_roughness0.png``, ``x_metallic0.png``, ... and, for an
            environment that is an image, ``x_environment.exr``.
        scene: The scene.

    Returns:
        The files that were written, the one of ``path`` last. All are complete before any takes its place.

    Raises:
        ValueError: If the name ends otherwise or has a line break, or the scene has two environments.
        OSError: If a file cannot be written.

    Cost: 2 s for 786,056 triangles.

    Example:
        >>> import tempfile
        >>> from fovden.tracer import make_scene
        >>> [file.name for file in write_obj(Path(tempfile.mkdtemp()) / "box.obj", make_scene("cornell_box"))]
        ['box.mtl', 'box.json', 'box.obj']
    """
    path = Path(path)
    require(path.suffix.lower() == ".obj", "path", path, "a name that ends in .obj")
    require(len(path.name.splitlines()) == 1, "path", repr(path.name), "a name in one line (OBJ files name others)")
    library, sidecar = path.with_suffix(".mtl"), path.with_suffix(".json")
    pictures = _pictures(path, scene.materials)
    surfaces = gather_surfaces(scene, every_normal=False)
    names = _unique_names([scene.materials.names[material] for material, _ in surfaces.runs])
    lights = _lights(path, scene)
    with ExitStack() as stack:  # leaves in reverse: the OBJ file, which names the others, takes its place last
        obj, *others = (
            stack.enter_context(atomic_write(file)) for file in [path, sidecar, library, *reversed(pictures)]
        )
        for temporary, image in zip(others[2:], reversed(pictures.values()), strict=True):
            temporary.write_bytes(png_bytes(image))
        _write(others[1], _library(path, scene, surfaces, names))
        described = _description(scene, lights, [scene.materials.names[i] for i, _ in surfaces.runs], names)
        _write(others[0], [json.dumps(described, indent=1, ensure_ascii=False)])
        _write(obj, _geometry(surfaces, names, library, sidecar))
        files = save_environment(path, split_lights(scene)[1])
    return [*files, *pictures, library, sidecar, path]


def _write(path: Path, texts: Iterable[str]) -> None:
    with path.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(texts)


def _geometry(surfaces: Surfaces, names: Sequence[str], library: Path, sidecar: Path) -> Iterator[str]:
    """The text of the OBJ file, in blocks of lines."""
    mapped = np.zeros(len(surfaces.faces), dtype=bool)
    for material, rows in surfaces.runs:
        mapped[rows] = surfaces.mapped[material]
    has_uv = np.zeros(len(surfaces.vertices), dtype=bool)
    has_uv[surfaces.faces[mapped]] = True
    has_normal = np.any(surfaces.normals != 0, axis=1)
    yield f"# {len(surfaces.faces)} triangles; metres, y up; camera and lights: {sidecar.name}\n"
    yield f"mtllib {_listed(library)}\n"
    yield from _lines("v %.9g %.9g %.9g\n", surfaces.vertices)
    yield from _lines("vt %.9g %.9g\n", surfaces.uv[has_uv])
    yield from _lines("vn %.9g %.9g %.9g\n", surfaces.normals[has_normal])
    v = surfaces.faces + 1
    vt, vn = (np.cumsum(mask)[surfaces.faces] for mask in (has_uv, has_normal))
    numbers = np.stack([v, vt, vn], axis=2)
    smooth = has_normal[surfaces.faces[:, 0]]
    for name, (_, rows) in zip(names, surfaces.runs, strict=True):
        yield f"usemtl {name}\n"
        yield from _face_lines(numbers[rows], mapped[rows], smooth[rows])


def _face_lines(
    numbers: npt.NDArray[Any], mapped: npt.NDArray[np.bool_], smooth: npt.NDArray[np.bool_]
) -> Iterator[str]:
    """Lines of faces, numbers of shape (m, 3, 3); with texture coordinates or normals where there are any."""
    corners = ("%d", "%d//%d", "%d/%d", "%d/%d/%d")
    templates = [f"f {corner} {corner} {corner}\n" for corner in corners]
    kinds = 2 * mapped + smooth
    written = np.stack([np.ones_like(mapped), mapped, smooth], axis=1)[:, None].repeat(3, axis=1)
    for i in range(0, len(numbers), BLOCK):
        block = slice(i, i + BLOCK)
        values = numbers[block][written[block]]
        yield "".join([templates[kind] for kind in kinds[block].tolist()]) % tuple(values.tolist())


def _lines(template: str, rows: npt.NDArray[Any]) -> Iterator[str]:
    for i in range(0, len(rows), BLOCK):
        block = rows[i : i + BLOCK]
        yield (template * len(block)) % tuple(block.reshape(-1).tolist())


def _pictures(path: Path, tables: Materials) -> dict[Path, Tensor]:
    """Image files and their texels; an image of factors becomes two."""
    found = {_image(path, "texture", i): image for i, image in enumerate(tables.textures)}
    found |= {_image(path, "opacity", i): image for i, image in enumerate(tables.opacities)}
    for i, image in enumerate(tables.surfaces):
        found |= {_image(path, "roughness", i): image[..., 0], _image(path, "metallic", i): image[..., 1]}
    return found


def _image(path: Path, kind: str, number: int) -> Path:
    return path.with_name(f"{path.stem}_{kind}{number}.png")


def _library(path: Path, scene: Scene, surfaces: Surfaces, names: Sequence[str]) -> Iterator[str]:
    """The text of the material library."""
    tables = scene.materials
    for name, (material, _) in zip(names, surfaces.runs, strict=True):
        emission, texture = tables.emission[material], int(tables.texture[material])
        yield f"newmtl {name}\nillum 1\nKd {_triple(tables.albedo[material])}\nKs 0 0 0\n"
        if bool((emission > 0).any()):
            yield f"Ke {_triple(emission)}\n"
        if texture >= 0:
            yield f"map_Kd {_listed(_image(path, 'texture', texture))}\n"
        if tables.opacity[material] >= 0:
            yield f"map_d {_listed(_image(path, 'opacity', int(tables.opacity[material])))}\n"
        yield from _finish(path, tables, material)
        yield "\n"


def _finish(path: Path, tables: Materials, material: int) -> Iterator[str]:
    """How a material reflects: statements that others know, and a note of what has none."""
    model, factors = MODELS[int(tables.model[material])], int(tables.surface[material])
    roughness, metallic, cutoff = (
        f"{shortest(table[material : material + 1])[0]:.9g}"
        for table in (tables.roughness, tables.metallic, tables.cutoff)
    )
    if model not in ("lambert", "oren_nayar"):
        mixed = model == "metallic_roughness"
        yield f"Pr {roughness}\nPm {metallic if mixed else 1}\n"
        if factors >= 0 and mixed:
            yield f"map_Pm {_listed(_image(path, 'metallic', factors))}\n"
    if factors >= 0 and model != "lambert":
        yield f"map_Pr {_listed(_image(path, 'roughness', factors))}\n"
    note = f" cutoff {cutoff}" if tables.opacity[material] >= 0 and float(tables.cutoff[material]) != CUTOFF else ""
    if model not in ("lambert", "metallic_roughness"):
        note += f" model {model} roughness {roughness} metallic {metallic}"
    if note:
        yield f"{NOTE}{note}\n"


def _triple(colour: torch.Tensor) -> str:
    return "{:.9g} {:.9g} {:.9g}".format(*shortest(colour))


def _listed(file: Path) -> str:
    """A file's name as a statement may give it: not to be taken for an option, nor its spaces for those before it."""
    return f"./{file.name}" if file.name[0] in "- " else file.name


def _unique_names(names: Sequence[str]) -> list[str]:
    """Names without white space and marks, none of them twice."""
    found: list[str] = []
    for name in names:
        plain = "".join(letter if letter.isalnum() or letter in ".+-_" else "_" for letter in name) or "material"
        candidate, number = plain, 1
        while candidate in found:
            number += 1
            candidate = f"{plain}_{number}"
        found.append(candidate)
    return found


def _lights(path: Path, scene: Scene) -> list[Json]:
    lights, environment = split_lights(scene)
    entries: list[Json] = []
    for light in lights:
        if isinstance(light, PointLight):
            entries.append({"type": "point", "position": light.position, "intensity": light.intensity})
        else:
            entries.append({"type": "directional", "direction": light.direction, "irradiance": light.irradiance})
    if environment is not None:
        entries.append({"type": "environment", **environment_entry(path, environment)})
    return entries


def _description(scene: Scene, lights: Sequence[Json], given: Sequence[str], names: Sequence[str]) -> Json:
    return {
        "name": scene.name,
        "units": {"length": "m", "intensity": "W/sr", "irradiance": "W/m^2", "radiance": "W/(m^2 sr)"},
        "camera": None if scene.camera is None else _camera(scene.camera),
        "views": {name: _camera(camera) for name, camera in scene.views.items()},
        "lights": lights,
        "materials": [{"name": name, "library_name": written} for name, written in zip(given, names, strict=True)],
    }


def _camera(camera: StereoCamera) -> Json:
    """A stereo camera as a person would describe it, and as matrices."""
    views = camera.views
    eyes = []
    for origin, rotation, bounds in zip(views.origin, views.rotation, views.bounds, strict=True):
        matrix = torch.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, origin
        eyes.append({"camera_to_world": [shortest(row) for row in matrix], "bounds": shortest(bounds)})
    height, width = camera.resolution
    left, right, bottom, top = views.bounds[0].double().tolist()
    # Shear moves the edges of a view, not their distance: the width of the image plane is that of the midway eye.
    fields = [float(np.degrees(2 * np.arctan(extent / 2))) for extent in (right - left, top - bottom)]
    return {
        "eye": camera.eye,
        "target": camera.target,
        "up": camera.up,
        "fov_x_deg": camera.fov_x_deg or fields[0],
        "fov_y_deg": camera.fov_y_deg or fields[1],
        "resolution": {"height": height, "width": width},
        "eye_separation": camera.eye_separation,
        "convergence": camera.convergence,
        "eyes": eyes,
    }
