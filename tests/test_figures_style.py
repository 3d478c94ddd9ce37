"""One look for all figures: a method's colour and mark, which every eye tells apart, also in greyscale."""

from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from skimage.color import rgb2lab

from fovden.comparison import METHODS
from fovden.figures import METHOD_STYLES, PRINT_WIDTH, drawing, method_style

LEAST_DIFFERENCE = 15  # CIE 1976; 2.3 is a just noticeable difference

# Machado, Oliveira, Fernandes, "A physiologically-based model for simulation of color vision deficiency", IEEE TVCG 15,
# 2009, severity 1.0: matrices on linear RGB.
SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def seen(colour: str, sight: str) -> np.ndarray:
    """CIE Lab of a colour as such an eye sees it."""
    encoded = np.array([int(colour[place : place + 2], 16) / 255 for place in (1, 3, 5)])
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    linear = np.clip(np.asarray(SIGHT[sight]) @ linear, 0, 1)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return rgb2lab(encoded[None, None])[0, 0]


def nearest(colours: list[str], sight: str) -> float:
    return min(np.linalg.norm(seen(one, sight) - seen(other, sight)) for one, other in combinations(colours, 2))


@pytest.mark.parametrize("sight", SIGHT)
def test_every_eye_tells_any_two_methods_apart(sight):
    assert nearest([style.colour for style in METHOD_STYLES.values()], sight) >= LEAST_DIFFERENCE


def test_the_simulation_finds_colours_that_are_confused():
    green, red = "#2ca02c", "#d62728"
    assert nearest([green, red], "normal") > 100
    assert nearest([green, red], "deuteranopia") < LEAST_DIFFERENCE
    assert nearest([green, red], "tritanopia") > 100
    assert nearest(["#008000", "#b85c00"], "protanopia") < LEAST_DIFFERENCE


def test_marks_alone_tell_methods_apart_in_greyscale():
    styles = list(METHOD_STYLES.values())
    assert len({style.marker for style in styles}) == len(styles)
    assert len({style.glyph for style in styles}) == len(styles)
    lightness = {name: seen(style.colour, "normal")[0] for name, style in METHOD_STYLES.items()}
    assert max(lightness.values()) < 75  # dark enough on white, whose lightness is 100


def test_every_method_of_the_comparison_has_a_place():
    assert {method.name for method in METHODS} | {"Reference"} == METHOD_STYLES.keys()


def test_other_methods_get_a_style_that_stays_and_is_nobody_elses():
    names = [f"method {number}" for number in range(200)]
    styles = [method_style(name) for name in names]
    assert styles == [method_style(name) for name in names]
    assert not {style.marker for style in styles} & {style.marker for style in METHOD_STYLES.values()}
    assert len(set(styles)) == 28  # 7 colours with 4 marks each
    assert method_style("BMFR")[:2] == ("#e69f00", "p")  # written down, so that it is the same in every process


def test_the_users_settings_do_not_reach_a_figure_and_are_kept():
    with mpl.rc_context({"font.size": 31, "axes.facecolor": "black", "text.usetex": True}):
        with drawing():
            assert (mpl.rcParams["font.size"], mpl.rcParams["axes.facecolor"]) == (7, "#ffffff")
            assert not mpl.rcParams["text.usetex"]
            panel = Figure(figsize=(PRINT_WIDTH, 2)).add_subplot()
            assert panel.xaxis.get_ticklabels()[0].get_fontsize() >= 6
        assert mpl.rcParams["font.size"] == 31
