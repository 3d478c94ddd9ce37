"""Scenes made in code, so that nothing needs to be downloaded."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType

from fovden.checks import require, require_integer
from fovden.tracer.procedural import atrium, cornell_box, forest, pink_room
from fovden.tracer.scene import Scene

__all__ = ["SCENES", "make_scene"]


SCENES: Mapping[str, Callable[..., Scene]] = MappingProxyType(
    {
        "atrium": atrium.atrium,
        "cornell_box": cornell_box.cornell_box,
        "forest": forest.forest,
        "pink_room": pink_room.pink_room,
    }
)
"""The scenes by name; each is a function of ``seed`` and ``detail``."""


def make_scene(name: str, *, seed: int = 0, detail: int | None = None) -> Scene:
    """Returns a scene made in code.

    Args:
        name: ``"atrium"``, a colonnaded court with 262,267 triangles, a sun and a point light; ``"cornell_box"``,
            38 triangles, two of them the lamp; ``"forest"``, a clearing at night with 198,541 triangles and 80 point
            lights in lanterns; ``"pink_room"``, a furnished sitting room with 786,056 triangles, a sun and two point
            lights.
        seed: For what is irregular in the scene, from 0; the same seed makes the same scene.
        detail: Number of triangles, from 10^3 to 10^7, met exactly; ``None`` for the scene's own. Fewer make curved
            things coarser and leave small things out, more make them finer and let more grow.

    Returns:
        The scene with its lights, its camera, other views and a path of 1000 frames.

    Raises:
        ValueError: If there is no scene of that name, or it cannot have that many triangles.

    Example:
        >>> make_scene("cornell_box").triangle_count
        38
        >>> make_scene("sponge")
        Traceback (most recent call last):
        ...
        ValueError: name: expected one of atrium, cornell_box, forest, pink_room, got sponge
    """
    require(name in SCENES, "name", name, f"one of {', '.join(SCENES)}")
    require_integer("seed", seed, minimum=0)
    return SCENES[name](seed=seed, detail=detail)
