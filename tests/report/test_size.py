"""How large a page with everything in it becomes."""

import pytest

from fovden.comparison import CompareSettings, SceneSettings, compare_denoisers
from fovden.report import report_comparison

ROWS = 7
"""Images beside the reference: the two noisy inputs, the mask ignored, Base, NH2LD, NH3LD, Base at equal paths."""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["atrium", "forest"])
def test_a_comparison_of_two_full_size_views_stays_below_forty_megabytes(name, tmp_path):
    """A reference of few samples: noise is harder to store than what it hides."""
    settings = CompareSettings(SceneSettings(name, resolution=(1080, 960)), reference_spp=16, repeats=1)
    compared = compare_denoisers(settings, tmp_path, progress=False)
    assert len(compared.methods) == ROWS
    assert 10e6 < report_comparison(tmp_path).stat().st_size < 40e6
