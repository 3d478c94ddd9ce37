"""Argument checks: what passes comes back, what fails is named."""

import math
from fractions import Fraction

import numpy as np
import pytest
import torch

from fovden.checks import (
    ShapeError,
    require,
    require_finite,
    require_integer,
    require_number,
    require_shapes,
    require_tensor,
)


def test_require_names_argument_value_and_expectation():
    require(True, "spp", 4, "at least 1")
    with pytest.raises(ValueError, match=r"^spp: expected at least 1, got 0$"):
        require(False, "spp", 0, "at least 1")


@pytest.mark.parametrize("value", [0, 0.5, np.float32(0.5), np.float64(0.5), np.int64(1), Fraction(1, 2)])
def test_require_number_returns_a_float(value):
    number = require_number("x", value, minimum=0, maximum=1)
    assert type(number) is float
    assert number == value


@pytest.mark.parametrize("value", [True, "1", None, 1j, torch.tensor(1.0)])
def test_require_number_refuses_other_types(value):
    with pytest.raises(TypeError, match=r"^x: expected a number, got"):
        require_number("x", value)


@pytest.mark.parametrize(
    ("value", "bounds", "words"),
    [
        (math.nan, {}, "a finite number"),
        (math.inf, {}, "a finite number"),
        (-math.inf, {"maximum": 1}, "at most 1"),
        (-0.1, {"minimum": 0}, "at least 0"),
        (1.1, {"minimum": 0, "maximum": 1}, "at least 0 and at most 1"),
        (0, {"above": 0}, "above 0"),
        (180, {"above": 0, "maximum": 179.9}, "above 0 and at most 179.9"),
    ],
)
def test_require_number_refuses_what_is_out_of_bounds(value, bounds, words):
    with pytest.raises(ValueError, match=rf"^x: expected a finite number.*got {value}$") as caught:
        require_number("x", value, **bounds)
    assert words in str(caught.value)


@pytest.mark.parametrize("value", [3, np.int32(3), np.uint8(3)])
def test_require_integer_returns_an_int(value):
    number = require_integer("n", value, minimum=3, maximum=3)
    assert type(number) is int
    assert number == 3


@pytest.mark.parametrize("value", [True, 3.0, "3", None])
def test_require_integer_refuses_other_types(value):
    with pytest.raises(TypeError, match=r"^n: expected an integer, got"):
        require_integer("n", value)


@pytest.mark.parametrize(
    ("value", "bounds", "words"),
    [
        (0, {"minimum": 1}, "an integer of at least 1, got 0"),
        (9, {"maximum": 8}, "an integer of at most 8, got 9"),
        (-1, {"minimum": 0, "maximum": 8}, "an integer of at least 0 and at most 8, got -1"),
    ],
)
def test_require_integer_refuses_what_is_out_of_bounds(value, bounds, words):
    with pytest.raises(ValueError, match=words):
        require_integer("n", value, **bounds)


def test_require_tensor():
    tensor = torch.ones(2)
    assert require_tensor("x", tensor) is tensor
    with pytest.raises(TypeError, match="x: expected a tensor, got ndarray"):
        require_tensor("x", np.ones(2))


def test_require_shapes_returns_the_sizes_of_letters():
    sizes = require_shapes("v 3 h w", {"k": 7}, a=torch.zeros(2, 3, 4, 5), b=torch.zeros(2, 3, 4, 5))
    assert sizes == {"k": 7, "v": 2, "h": 4, "w": 5}
    assert require_shapes("* 1 * *", a=torch.zeros(2, 1, 4, 5)) == {}
    assert require_shapes("n n", a=torch.zeros(3, 3)) == {"n": 3}


@pytest.mark.parametrize(
    ("pattern", "shape"),
    [
        ("v 3 h w", (2, 4, 4, 4)),
        ("v 3 h w", (2, 3, 4)),
        ("v 3 h w", (2, 3, 4, 4, 1)),
        ("n n", (3, 4)),
        ("* *", (3,)),
    ],
)
def test_require_shapes_refuses_a_shape_that_does_not_match(pattern, shape):
    with pytest.raises(ShapeError) as caught:
        require_shapes(pattern, guide=torch.zeros(shape))
    assert "guide" in str(caught.value)
    assert str(tuple(shape)) in str(caught.value)


def test_require_shapes_refuses_neighbours_that_disagree():
    with pytest.raises(ShapeError, match=r"^b: expected shape \(v=2, 3, h=4, w=5\), got \(1, 3, 4, 5\)$"):
        require_shapes("v 3 h w", a=torch.zeros(2, 3, 4, 5), b=torch.zeros(1, 3, 4, 5))


def test_require_shapes_leaves_the_known_sizes_alone():
    known = {"v": 2}
    require_shapes("v h", known, a=torch.zeros(2, 3))
    assert known == {"v": 2}


def test_require_finite_names_the_first_offender():
    tensor = torch.tensor([[0.0, 1.0], [math.nan, math.inf]])
    with pytest.raises(ValueError, match=r"^radiance: expected finite values, got nan at index \(1, 0\)$"):
        require_finite("radiance", tensor)
    with pytest.raises(ValueError, match=r"of at least 0.5, got 0.0 at index \(0, 0\)"):
        require_finite("radiance", torch.zeros(1, 1), minimum=0.5)
    for sound in (torch.zeros(0), torch.tensor([-1.0, 2.0]), torch.tensor([1, 2])):
        assert require_finite("radiance", sound) is sound
