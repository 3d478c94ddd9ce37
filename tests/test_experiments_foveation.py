"""Ways to place paths are traced, fitted and judged, and their figure is drawn again from the numbers."""

import pytest

from fovden.figures import curves_of_ways, draw_foveations
from fovden.results import read_metrics

compare_foveation = pytest.importorskip("experiments.compare_foveation", reason="not a checkout")
foveations = pytest.importorskip("experiments.foveations", reason="not a checkout")


def test_all_ways_get_the_same_paths_and_are_judged_alike(tmp_path, capsys):
    settings = compare_foveation.Settings(
        scenes=("atrium",),
        resolution=(48, 48),
        reference_spp=2,
        budgets=(0.4, 0.6),
        shares=(0.4, 0.3),
        gazes=((0.5, 0.5), (0.2, 0.3)),
        steps=1,
        poses=1,
        repeats=1,
    )
    compare_foveation.run(settings, tmp_path)
    table = capsys.readouterr().out
    rows = read_metrics(tmp_path)
    names = list(foveations.FOVEATIONS)
    pixels = 2 * 48 * 48
    for name in names:
        assert name in table
        for variant in ("tuned", "untuned"):
            method = f"{name}, {variant}"
            judged = {(row.region, row.metric) for row in rows if row.method == method}
            assert {(region, "rmse") for region in ("whole", "layer 0", "layer 2", "acuity")} <= judged
        paths = [row.value for row in rows if (row.method, row.metric) == (f"{name}, tuned", "paths")]
        assert len(paths) == 2
        if not name.endswith("fixed"):  # on so small a screen a column of cells is a twentieth of them
            assert paths == pytest.approx([0.4 * pixels] * 2, rel=0.06)
    for unit, costs in (("paths", 2), ("cells", 2)):
        curves = curves_of_ways(rows, "atrium", "acuity", unit)
        assert list(curves) == [name for name in names if not name.endswith("fixed")]
        assert all(len(points) == costs for points in curves.values())
    first = (tmp_path / "foveations.png").read_bytes()
    assert draw_foveations(tmp_path).read_bytes() == first
