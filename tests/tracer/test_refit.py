"""Structures fitted to moved triangles: hits against a brute force, and a new tree where the old one fails."""

import numpy as np
import pytest
import torch
from brute_force import check
from builders import box, generator, rounded, soup, sphere

from fovden.tracer import build_bvh, intersect, occluded
from fovden.tracer.bvh import DEARER, build_tree, refit_bvh
from fovden.tracer.kernels import refit
from fovden.tracer.kernels.layout import PRIMITIVES, WIDTH


def room():
    """A ball of 320 triangles in a box of 192; the vertices of the ball come last."""
    walls, ball = box((4, 4, 4), (8.0, 8.0, 8.0)), sphere(2)
    vertices = torch.cat([rounded(walls[0]), rounded(ball[0])])
    return vertices, torch.cat([walls[1], ball[1] + len(walls[0])]), len(walls[0])


def travelled(shift):
    vertices, faces, first = room()
    moved = vertices.clone()
    moved[first:] = rounded(vertices[first:], 1.0, (shift, shift / 3, 0.0))
    return vertices, moved, faces


def scattered(share=1.0):
    """Small triangles, and the same on the way to each other's places."""
    vertices, faces = soup(400, size=0.02)
    order = torch.randperm(400, generator=generator(1))
    return vertices, vertices.lerp(vertices.reshape(-1, 3, 3)[order].reshape(-1, 3), share), faces


def grown():
    """Every second triangle was a point: those had no area, and get one."""
    vertices, faces = soup(300)
    points = vertices.reshape(-1, 3, 3).clone()
    points[::2] = points[::2].mean(1, keepdim=True)
    return points.reshape(-1, 3), vertices, faces


def triangles_of(bvh):
    return bvh.blocks.view(torch.int32)[:, PRIMITIVES : PRIMITIVES + WIDTH]


CASES = {
    "at rest": (lambda: travelled(0.0), True),
    "a step": (lambda: travelled(0.05), True),
    "across": (lambda: travelled(2.0), None),  # either will do
    "scattered": (scattered, False),
    "grown": (grown, None),
}


@pytest.mark.parametrize("case", CASES)
def test_hits_after_a_move_equal_a_brute_force(case):
    make, kept = CASES[case]
    before, after, faces = make()
    bvh = refit_bvh(build_tree(before, faces), after, faces)
    random = generator(2)
    origins = torch.rand(2000, 3, generator=random) * 4 - 2
    centres = after[faces.long()].mean(1)
    directions = centres[torch.randint(len(faces), (2000,), generator=random)] - origins
    directions[::2] = torch.randn(1000, 3, generator=random)
    hits = intersect(bvh, origins, directions)
    assert check((after, faces), origins, directions, hits, occluded(bvh, origins, directions)) > 0.9
    assert (hits.prim >= 0).any()
    if kept is not None:
        assert torch.equal(triangles_of(bvh), triangles_of(build_bvh(before if kept else after, faces)))


def test_at_rest_it_is_the_structure_that_is_built():
    vertices, faces, _ = room()
    built, fitted = build_bvh(vertices, faces), refit_bvh(build_tree(vertices, faces), vertices, faces)
    assert all(torch.equal(a.view(torch.int32), b.view(torch.int32)) for a, b in zip(built, fitted, strict=True))


def refitted(before, after, faces, *, moved):
    """The binary tree of the triangles in one place, fitted to them in another: boxes, and what rays cost."""
    tree = build_tree(before, faces).binary
    fitted = tree._replace(node_boxes=np.zeros_like(tree.node_boxes))
    corners = after[faces.long()].numpy()
    refit.refit(fitted, np.concatenate([corners.min(1), corners.max(1)], 1), moved)
    return fitted, refit.cost_of(fitted, fitted.node_boxes), refit.cost_of(fitted, tree.node_boxes)


def test_boxes_hold_their_triangles_and_cost_is_their_area():
    """Node by node in NumPy, from a plain walk of the tree, with all triangles moved: pieces have no boxes then."""
    before, after, faces = travelled(1.0)
    tree, found_cost, _ = refitted(before, after, faces, moved=np.ones(len(faces), bool))
    corners = after[faces.long()].numpy()

    def nodes(node):
        if tree.count[node] > 0:
            return [node]
        return [node, *nodes(tree.left[node]), *nodes(tree.left[node] + 1)]

    cost = 0.0
    for node in nodes(0):
        leaves = [each for each in nodes(node) if tree.count[each] > 0]
        runs = [tree.order[tree.first[leaf] : tree.first[leaf] + tree.count[leaf]] for leaf in leaves]
        inside = corners[np.concatenate(runs)].reshape(-1, 3)
        assert np.array_equal(tree.node_boxes[node], np.concatenate([inside.min(0), inside.max(0)]))
        x, y, z = (inside.max(0) - inside.min(0)).astype(float)
        cost += x * y + y * z + z * x  # leaves hold at most eight triangles, so every node counts once
    assert set(tree.order) == set(range(len(faces)))
    # Each half area is rounded five times in float32, the sum of positive numbers in float64.
    assert abs(found_cost / cost - 1) < 5 * 2.0**-24


def test_a_tree_that_would_cost_rays_more_is_built_anew():
    kept = []
    for share in np.linspace(0, 0.5, 11):
        before, after, faces = scattered(float(share))
        moved = (before != after).any(1)[faces.long()].any(1).numpy()
        _, cost, cost_before = refitted(before, after, faces, moved=moved)
        kept.append(cost <= DEARER * cost_before)
        built = build_bvh(before if kept[-1] else after, faces)
        assert torch.equal(triangles_of(refit_bvh(build_tree(before, faces), after, faces)), triangles_of(built))
    assert kept[0]
    assert kept[1]
    assert not kept[-1]
