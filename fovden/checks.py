"""Argument checks whose messages name the argument, the value and what was expected.

Every check returns what it checked, so that it can stand in an assignment, and raises a subclass of
:class:`ValueError` (:class:`TypeError` for a wrong type). Shapes are written as words, ``"v 3 h w"``: a number
must match exactly, a letter must mean the same size wherever it occurs in one call, ``*`` matches any size.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Integral, Real

import torch
from torch import Tensor

__all__ = [
    "ShapeError",
    "require",
    "require_coordinates",
    "require_finite",
    "require_indices",
    "require_integer",
    "require_number",
    "require_scalar",
    "require_shapes",
    "require_tensor",
]


class ShapeError(ValueError):
    """A tensor whose shape is not the one asked for, or disagrees with its neighbours."""


def require(condition: bool, name: str, value: object, expected: str) -> None:
    """Raises a ``ValueError`` naming the argument unless the condition holds.

    Args:
        condition: What must be true.
        name: The argument's name, as the caller knows it.
        value: The offending value, printed as it is.
        expected: What was expected, in words.

    Raises:
        ValueError: If ``condition`` is false.

    Example:
        >>> require(False, "spp", 0, "at least 1")
        Traceback (most recent call last):
        ...
        ValueError: spp: expected at least 1, got 0
    """
    if not condition:
        raise ValueError(f"{name}: expected {expected}, got {value}")


def require_number(
    name: str, value: object, *, minimum: float = -math.inf, maximum: float = math.inf, above: float = -math.inf
) -> float:
    """Returns a finite real number within bounds, as a float.

    Args:
        name: The argument's name.
        value: The value; booleans and tensors are refused.
        minimum: Smallest value allowed.
        maximum: Largest value allowed.
        above: The value must be greater than this.

    Returns:
        ``float(value)``.

    Raises:
        TypeError: If ``value`` is not a real number.
        ValueError: If it is not finite or out of bounds.

    Example:
        >>> require_number("eye_separation", 0.063, minimum=0)
        0.063
    """
    if isinstance(value, bool) or not isinstance(value, Real):
        raise TypeError(f"{name}: expected a number, got {value!r}")
    number = float(value)
    bounds = []
    if minimum > -math.inf:
        bounds.append(f"at least {minimum:g}")
    if above > -math.inf:
        bounds.append(f"above {above:g}")
    if maximum < math.inf:
        bounds.append(f"at most {maximum:g}")
    expected = "a finite number" + (", " + " and ".join(bounds) if bounds else "")
    require(math.isfinite(number) and minimum <= number <= maximum and number > above, name, value, expected)
    return number


def require_scalar(
    name: str, value: object, *, minimum: float = -math.inf, maximum: float = math.inf, above: float = -math.inf
) -> float | Tensor:
    """Returns a finite real number within bounds, or a tensor without axes that holds one and may carry a gradient.

    Args:
        name: The argument's name.
        value: The value; booleans are refused.
        minimum: Smallest value allowed.
        maximum: Largest value allowed.
        above: The value must be greater than this.

    Returns:
        ``float(value)``, or the tensor itself.

    Raises:
        TypeError: If ``value`` is neither a real number nor a floating tensor.
        ShapeError: If it is a tensor with axes.
        ValueError: If it is not finite or out of bounds.

    Example:
        >>> require_scalar("slope", torch.tensor(0.022), above=0)
        tensor(0.0220)
    """
    if not isinstance(value, Tensor):
        return require_number(name, value, minimum=minimum, maximum=maximum, above=above)
    require_shapes("", **{name: value})
    if not value.is_floating_point():
        raise TypeError(f"{name}: expected a floating type, got {value.dtype}")
    require_number(name, value.item(), minimum=minimum, maximum=maximum, above=above)
    return value


def require_indices(name: str, indices: Tensor, count: int) -> None:
    """Raises unless a tensor that is not empty holds integers from 0 to ``count`` - 1.

    Args:
        name: Name of the argument.
        indices: What was given.
        count: Number of things that they index.

    Raises:
        ValueError: If they are not integers, or out of range.

    Example:
        >>> require_indices("faces", torch.tensor([0, 3]), 3)
        Traceback (most recent call last):
        ValueError: faces: expected indices from 0 to 2, got 0 to 3
    """
    require(not indices.is_floating_point(), name, indices.dtype, "an integer type")
    lowest, highest = int(indices.min()), int(indices.max())
    require(lowest >= 0 and highest < count, name, f"{lowest} to {highest}", f"indices from 0 to {count - 1}")


def require_coordinates(name: str, coords: Tensor, views: int, resolution: tuple[int, int]) -> None:
    """Raises unless all rows of a tensor name pixels of some views.

    Args:
        name: Name of the argument.
        coords: View, y and x of each pixel, shape (n, 3).
        views: Number of views.
        resolution: Height and width of a view in pixels.

    Raises:
        ShapeError: If the shape differs.
        ValueError: If a pixel lies outside.

    Example:
        >>> require_coordinates("coords", torch.tensor([[0, 1, 4]]), 2, (3, 4))
        Traceback (most recent call last):
        ValueError: coords: expected view, y and x from 0 to below [2, 3, 4], got [[0, 1, 4]]
    """
    require_shapes("n 3", **{name: coords})
    limits = torch.tensor([views, *resolution], device=coords.device)
    outside = coords[((coords < 0) | (coords >= limits)).any(dim=1)]
    require(len(outside) == 0, name, outside[:1].tolist(), f"view, y and x from 0 to below {limits.tolist()}")


def require_integer(name: str, value: object, *, minimum: int | None = None, maximum: int | None = None) -> int:
    """Returns an integer within bounds.

    Args:
        name: The argument's name.
        value: The value; booleans and floats are refused.
        minimum: Smallest value allowed.
        maximum: Largest value allowed.

    Returns:
        ``int(value)``.

    Raises:
        TypeError: If ``value`` is not an integer.
        ValueError: If it is out of bounds.

    Example:
        >>> require_integer("spp", 4, minimum=1)
        4
    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name}: expected an integer, got {value!r}")
    number = int(value)
    expected = "an integer"
    if minimum is not None:
        expected += f" of at least {minimum}"
    if maximum is not None:
        expected += f"{' and' if minimum is not None else ' of'} at most {maximum}"
    inside = (minimum is None or number >= minimum) and (maximum is None or number <= maximum)
    require(inside, name, number, expected)
    return number


def require_tensor(name: str, value: object) -> Tensor:
    """Returns the value if it is a tensor.

    Args:
        name: The argument's name.
        value: The value.

    Returns:
        ``value``.

    Raises:
        TypeError: If it is anything but a tensor.

    Example:
        >>> require_tensor("mask", torch.ones(2)).shape
        torch.Size([2])
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name}: expected a tensor, got {type(value).__name__}")
    return value


def require_shapes(pattern: str, sizes: Mapping[str, int] | None = None, /, **tensors: Tensor) -> dict[str, int]:
    """Checks that every tensor has the shape that the pattern describes, and returns the sizes of its letters.

    Args:
        pattern: Words such as ``"v 3 h w"``; see the module's docstring.
        sizes: Sizes that are already known, from an earlier call.
        **tensors: The tensors by argument name.

    Returns:
        The size of each letter, those of ``sizes`` included.

    Raises:
        TypeError: If an argument is not a tensor.
        ShapeError: If a shape differs, naming the argument, its shape and the axis.

    Example:
        >>> require_shapes("v 3 h w", radiance=torch.zeros(2, 3, 4, 5))
        {'v': 2, 'h': 4, 'w': 5}
        >>> require_shapes("v 1 h w", {"v": 2}, mask=torch.zeros(1, 1, 4, 5))
        Traceback (most recent call last):
        ...
        fovden.checks.ShapeError: mask: expected shape (v=2, 1, h, w), got (1, 1, 4, 5)
    """
    known = dict(sizes or {})
    words = pattern.split()
    for name, tensor in tensors.items():
        shape = tuple(require_tensor(name, tensor).shape)
        matched = len(shape) == len(words)
        found = dict(known)
        for word, size in zip(words, shape, strict=False):
            if word.isdigit():
                matched &= size == int(word)
            elif word != "*":
                matched &= found.setdefault(word, size) == size
        if not matched:
            described = ", ".join(f"{word}={known[word]}" if word in known else word for word in words)
            raise ShapeError(f"{name}: expected shape ({described}), got {shape}")
        known = found
    return known


def require_finite(name: str, tensor: Tensor, *, minimum: float = -math.inf) -> Tensor:
    """Returns the tensor if all of its entries are finite and none is below the minimum.

    In a function that is being compiled values are not known, and nothing is checked.

    Args:
        name: The argument's name.
        tensor: Any floating tensor.
        minimum: Smallest entry allowed.

    Returns:
        ``tensor``.

    Raises:
        ValueError: With the first offending index and its value.

    Example:
        >>> require_finite("radiance", torch.tensor([0.5, -1.0]), minimum=0)
        Traceback (most recent call last):
        ...
        ValueError: radiance: expected finite values of at least 0, got -1.0 at index (1,)
    """
    if torch.compiler.is_compiling() or tensor.numel() == 0:
        return tensor
    least, most = torch.aminmax(tensor.detach())  # one look at each entry, a tenth of what isfinite takes; NaN stays
    if not bool((least >= minimum) & (least > -math.inf) & (most < math.inf)):
        sound = torch.isfinite(tensor) & (tensor >= minimum)
        index = tuple(int(i) for i in (~sound).nonzero()[0])
        bound = f" of at least {minimum:g}" if minimum > -math.inf else ""
        raise ValueError(f"{name}: expected finite values{bound}, got {tensor[index].item()} at index {index}")
    return tensor
