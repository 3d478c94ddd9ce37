"""Ray queries as operators of PyTorch, so that functions that trace rays compile without a break in their graph.

``torch.ops.fovden.intersect`` and ``torch.ops.fovden.occluded`` take tensors and the number of a scene: what the
kernels read of it (acceleration structure, materials, images) is looked up when the operator runs, and made if it is
the first to ask. Numbers hold for one process; a scene's is given back with the scene.

The operators themselves have no derivative. :meth:`fovden.tracer.Scene.intersect` attaches it, in plain tensor
operations that autograd, forward mode and ``torch.func`` take apart (:mod:`fovden.tracer.gradient`).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count
from typing import TYPE_CHECKING, Any
from weakref import WeakValueDictionary

import torch
from torch import Tensor

from fovden.tracer.bvh import intersect, occluded

if TYPE_CHECKING:
    from fovden.tracer.scene import Scene

__all__ = ["define_operator", "number_of", "scene_of"]

_SCENES: WeakValueDictionary[int, Scene] = WeakValueDictionary()
_NUMBERS = count(1)


def number_of(scene: Scene) -> int:
    """Gives a scene the number by which operators find it, and returns it.

    Example:
        >>> from fovden.tracer import make_scene
        >>> scene = make_scene("cornell_box")
        >>> scene_of(number_of(scene)) is scene
        True
    """
    number = next(_NUMBERS)
    _SCENES[number] = scene
    return number


def scene_of(number: int) -> Scene:
    """Returns the scene of a number.

    Raises:
        RuntimeError: If this process has no such scene: it was deleted, or the number comes from another process.

    Example:
        >>> scene_of(0)
        Traceback (most recent call last):
        ...
        RuntimeError: scene: expected the number of a scene that this process holds, got 0
    """
    scene = _SCENES.get(number)
    if scene is None:
        raise RuntimeError(f"scene: expected the number of a scene that this process holds, got {number}")
    return scene


def define_operator(schema: str, run: Callable[..., Any], fake: Callable[..., Any]) -> None:
    """Registers an operator.

    Not by ``torch.library.custom_op``: with PyTorch 2.13 the first call of such an operator imports the compiler,
    which takes a second, and every call costs 15 microseconds more.

    Args:
        schema: Name, arguments and results in PyTorch's notation. None of the results may share memory with another
            or with an argument.
        run: Computes the results.
        fake: Makes tensors of their shapes and types.

    Example:
        >>> define_operator("fovden_example::twice(Tensor x) -> Tensor", lambda x: 2 * x, torch.empty_like)
        >>> torch.ops.fovden_example.twice(torch.ones(2))
        tensor([2., 2.])
    """
    name = schema[: schema.index("(")]
    torch.library.define(name, schema[len(name) :])
    torch.library.impl(name, "default", run)
    torch.library.register_fake(name, fake)


def _intersect(number: int, origins: Tensor, directions: Tensor, t_max: Tensor | None, cutouts: bool) -> Any:
    scene = scene_of(number)
    return tuple(intersect(scene.bvh, origins, directions, t_max, scene.holes(cutouts)))


def _like_hits(_scene: int, origins: Tensor, *_: object) -> tuple[Tensor, ...]:
    t, u, v = (origins.new_empty(origins.shape[0], dtype=torch.float32) for _ in range(3))
    return t, u, v, origins.new_empty(origins.shape[0], dtype=torch.int32)


def _occluded(number: int, origins: Tensor, directions: Tensor, t_max: Tensor | None, cutouts: bool) -> Tensor:
    scene = scene_of(number)
    return occluded(scene.bvh, origins, directions, t_max, scene.holes(cutouts))


def _like_occluded(_scene: int, origins: Tensor, *_: object) -> Tensor:
    return origins.new_empty(origins.shape[0], dtype=torch.bool)


_RAYS = "(int scene, Tensor origins, Tensor directions, Tensor? t_max, bool cutouts)"
define_operator(f"fovden::intersect{_RAYS} -> (Tensor t, Tensor u, Tensor v, Tensor prim)", _intersect, _like_hits)
define_operator(f"fovden::occluded{_RAYS} -> Tensor", _occluded, _like_occluded)


def _batched(name: str) -> Callable[..., Any]:
    """How an operator on rays answers ``torch.func.vmap``: all rays of the batch in one call."""

    def rule(info: Any, axes: Any, scene: int, *arguments: Any) -> Any:
        size = info.batch_size
        *rays, cutouts = arguments
        moved = [
            ray if ray is None else ray.expand(size, *ray.shape) if axis is None else ray.movedim(axis, 0)
            for ray, axis in zip(rays, axes[1:4], strict=True)
        ]
        flat = (ray if ray is None else ray.flatten(0, 1) for ray in moved)
        found = getattr(torch.ops.fovden, name)(scene, *flat, cutouts)
        if isinstance(found, Tensor):
            return found.reshape(size, -1), 0
        return tuple(field.reshape(size, -1) for field in found), (0,) * len(found)

    return rule


for _name in ("intersect", "occluded"):
    torch.library.register_vmap(f"fovden::{_name}", _batched(_name))
