"""Cameras and lights as glTF has them, both ways: what the writer puts down here the reader takes up here.

A node stands in the world by its matrix, columns first. Its camera looks along -z with y up, and a directional light
shines along -z. ``KHR_lights_punctual`` is photometric, fovden radiometric: candela and lux stand for W/sr and W/m^2
one to one, per channel.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from fovden.camera import StereoCamera
from fovden.tracer.formats.scene_file import Floats
from fovden.tracer.lights import DirectionalLight, Light, PointLight

__all__ = ["camera_entry", "camera_of", "extras_of", "light_entry", "light_of"]

Json = dict[str, Any]

NEAR = 0.01
"""Distance of the near plane in metres, which glTF demands and a path tracer has no use for: ours, one centimetre, so
that nothing that an eye would see is cut away, and depth buffers keep some precision."""


def extras_of(entry: Json) -> Json:
    """Returns what fovden wrote into the ``extras`` of a part of a file; empty where another program wrote them.

    Example:
        >>> extras_of({"extras": {"fovden": {"default": True}}}), extras_of({"extras": "mine"})
        ({'default': True}, {})
    """
    extras = entry.get("extras")
    found = extras.get("fovden") if isinstance(extras, dict) else None
    return dict(found) if isinstance(found, dict) else {}


def camera_entry(camera: StereoCamera, name: str, *, default: bool) -> tuple[Json, Json]:
    """Returns a stereo camera as glTF: the view of the point midway between the eyes.

    glTF knows one eye and symmetric frusta; ``extras.fovden`` says the rest: ``eye_separation`` and ``convergence``
    in metres (the eyes sit half the separation to either side along the node's x axis), ``target_distance`` in metres
    along the viewing axis, ``resolution`` (height, width), ``fov_axis``, the axis along which the field of view stays
    when the resolution changes, and whether this is the scene's ``default`` view.

    Args:
        camera: The camera.
        name: Its name.
        default: Whether it is the scene's own camera rather than one of its other views.

    Returns:
        The entry of ``cameras``; and the node, without the number of the camera.

    Example:
        >>> camera = StereoCamera.look_at((0, 1, 5), (0, 1, 0), fov_y_deg=90, resolution=(200, 300))
        >>> entry, node = camera_entry(camera, "front", default=True)
        >>> entry["perspective"]["aspectRatio"], node["matrix"][12:15]
        (1.5, [0.0, 1.0, 5.0])
    """
    height, width = camera.resolution
    if camera.fov_y_deg is not None:
        half = math.tan(math.radians(camera.fov_y_deg) / 2)
    else:
        half = math.tan(math.radians(camera.fov_x_deg or 0.0) / 2) * height / width
    stereo = {
        "default": default,
        "eye_separation": camera.eye_separation,
        "convergence": camera.convergence,
        "target_distance": math.dist(camera.eye, camera.target),
        "resolution": [height, width],
        "fov_axis": "x" if camera.fov_y_deg is None else "y",
    }
    lens = {"yfov": 2 * math.atan(half), "aspectRatio": width / height, "znear": NEAR}
    entry = {"type": "perspective", "name": name, "perspective": lens, "extras": {"fovden": stereo}}
    backward = np.subtract(camera.eye, camera.target)
    return entry, {"name": name, "matrix": _pose(np.array(camera.eye), backward, np.array(camera.up))}


def camera_of(path: Path, camera: Json, world: Floats) -> StereoCamera | None:
    """Returns the view of a glTF camera.

    Args:
        path: The file, for messages.
        camera: The entry of ``cameras``; without the extras of :func:`camera_entry` the view has the resolution and
            the eye separation of :class:`fovden.camera.StereoCamera`.
        world: The node's transform to the world, shape (4, 4).

    Returns:
        The camera; ``None`` for an orthographic one.

    Warns:
        UserWarning: If the camera is orthographic.

    Example:
        >>> camera_of(Path("a.glb"), {"perspective": {"yfov": 1.0}}, np.eye(4)).target
        (0.0, 0.0, -1.0)
    """
    if "perspective" not in camera:
        warnings.warn(f"{path}: the {camera.get('type')} camera is left out", stacklevel=5)
        return None
    stereo = extras_of(camera)
    eye = world[:3, 3]
    backward = world[:3, 2] / (np.linalg.norm(world[:3, 2]) or 1.0)
    x, y, z = eye.tolist()
    a, b, c = (eye - backward * float(stereo.get("target_distance", 1.0))).tolist()
    u, v, w = world[:3, 1].tolist()
    known = StereoCamera((x, y, z), (a, b, c), (u, v, w), fov_y_deg=math.degrees(camera["perspective"]["yfov"]))
    if not stereo:
        return known
    height, width = stereo["resolution"]
    lens = {"resolution": (height, width), **{key: stereo[key] for key in ("eye_separation", "convergence")}}
    if stereo["fov_axis"] == "x":
        half = math.tan(camera["perspective"]["yfov"] / 2) * width / height
        lens |= {"fov_y_deg": None, "fov_x_deg": math.degrees(2 * math.atan(half))}
    return replace(known, **lens)


def light_entry(light: PointLight | DirectionalLight, name: str) -> tuple[Json, Json]:
    """Returns a point or directional light as ``KHR_lights_punctual`` has it.

    The intensity is that of the strongest channel and the colour is relative to it.

    Args:
        light: The light.
        name: Its name.

    Returns:
        The entry of the extension's ``lights``; and the node, without the number of the light.

    Example:
        >>> light_entry(PointLight((0, 3, 0), (40, 20, 10)), "lamp")[0]
        {'type': 'point', 'name': 'lamp', 'color': [1.0, 0.5, 0.25], 'intensity': 40.0}
    """
    if isinstance(light, PointLight):
        kind, quantity, pose = "point", light.intensity, {"translation": list(light.position)}
    else:
        backward = -np.array(light.direction)
        kind, quantity, pose = "directional", light.irradiance, {"matrix": _pose(np.zeros(3), backward)}
    assert isinstance(quantity, tuple)  # made so by the light
    strongest = max(quantity)
    colour = [value / strongest if strongest > 0 else 1.0 for value in quantity]
    return {"type": kind, "name": name, "color": colour, "intensity": strongest}, {"name": name, **pose}


def light_of(path: Path, light: Json, world: Floats) -> Iterator[Light]:
    """Yields the light of a node, if it is of a kind that fovden has.

    Args:
        path: The file, for messages.
        light: The entry of ``KHR_lights_punctual``; its range is ignored.
        world: The node's transform to the world, shape (4, 4).

    Yields:
        The light; nothing for a spot light.

    Warns:
        UserWarning: If it is a spot light.

    Example:
        >>> next(light_of(Path("a.glb"), {"type": "point", "intensity": 5.0}, np.eye(4))).intensity
        (5.0, 5.0, 5.0)
    """
    kind = light["type"]
    red, green, blue = (float(light.get("intensity", 1.0)) * float(x) for x in light.get("color", [1, 1, 1]))
    if kind == "point":
        x, y, z = world[:3, 3].tolist()
        yield PointLight((x, y, z), (red, green, blue))
    elif kind == "directional":
        x, y, z = (-world[:3, 2]).tolist()
        yield DirectionalLight((x, y, z), (red, green, blue))
    else:
        warnings.warn(f"{path}: the {kind} light '{light.get('name', '')}' is left out", stacklevel=5)


def _pose(position: Floats, backward: Floats, up: Floats | None = None) -> list[float]:
    """The sixteen numbers of a node's matrix from its place and axes; without ``up`` any turn about the axis."""
    backward = backward / np.linalg.norm(backward)
    if up is None:
        up = np.eye(3)[int(np.argmin(np.abs(backward)))]
    right = np.cross(up, backward)
    right = right / np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(backward, right), backward, position], axis=1)
    return list(map(float, matrix.T.reshape(-1)))
