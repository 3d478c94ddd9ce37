"""Ways to place paths are traced, fitted and judged, and their figure is drawn again from the numbers."""

import pytest
import torch

from fovden.figures import curves_of_ways, draw_foveations
from fovden.results import read_metrics
from fovden.tracer import make_scene

compare_foveation = pytest.importorskip("experiments.compare_foveation", reason="not a checkout")
foveations = pytest.importorskip("experiments.foveations", reason="not a checkout")
ray_order = pytest.importorskip("experiments.ray_order", reason="not a checkout")


def test_all_ways_get_the_same_paths_and_are_judged_alike(tmp_path, capsys):
    settings = compare_foveation.Settings(
        scenes=("atrium",),
        resolution=(48, 48),
        reference_spp=2,
        training_spp=2,
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
    assert (tmp_path / "atrium.png").exists()
    assert (tmp_path / "densities.png").exists()
    first = (tmp_path / "foveations.png").read_bytes()
    assert draw_foveations(tmp_path).read_bytes() == first


def test_rays_of_every_order_are_timed(tmp_path):
    ray_order.run(ray_order.Settings(("atrium",), (24, 24), rounds=2), tmp_path)
    rows = read_metrics(tmp_path)
    methods = {row.method for row in rows}
    assert {"Screen, by rows", "Visual-polar, by columns"} <= methods
    assert len(rows) == 2 * 2 * len(methods)  # rounds, and camera rays and bounces
    assert all(row.value > 0 for row in rows)


def test_orders_hold_the_same_rays_and_bounces_leave_the_surface():
    scene = make_scene("cornell_box")
    camera = scene.view().at(resolution=(20, 20))
    orders = ray_order.orders(camera, 0.4)
    rays = {name: ray_order.camera_rays(camera, *cells) for name, cells in orders.items()}
    torch.testing.assert_close(rays["Screen, by rows"][1], camera.views.rays().directions.reshape(-1, 3))
    for one, other in (("Screen, by rows", "Screen, shuffled"), ("Log-polar, by rows", "Log-polar, by columns")):
        both = (sorted(map(tuple, rays[name][1].tolist())) for name in (one, other))
        assert next(both) == next(both)
    origins, directions = ray_order.bounce_rays(scene, *rays["Screen, by rows"], torch.Generator().manual_seed(1))
    hits = scene.intersect(*rays["Screen, by rows"])
    hit = hits.prim >= 0
    assert len(origins) == len(directions) == int(hit.sum()) > 0
    corners = scene.vertices[scene.faces[hits.prim[hit].long()].long()]
    normal = torch.linalg.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    seen, leaves = ((normal * each).sum(1).sign() for each in (rays["Screen, by rows"][1][hit], directions))
    assert torch.equal(seen, -leaves)
