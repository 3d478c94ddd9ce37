"""Small polar rasters of every kind, and frames in their cells."""

from dataclasses import replace

import torch
from filter_frames import make_frame

from fovden.camera import Gaze
from fovden.foveation import LogPolarWarp, ScreenWarp, VisualPolarWarp
from fovden.frame import Frame

GAZES = {
    "centre": [[8.0, 6.0]],
    "outside": [[-4.2, 17.7]],
    "per eye": [[9.1, 5.2], [6.4, 5.9]],
}
SCREEN = (12, 16)
RASTERS = {
    "screen": lambda gaze, size: ScreenWarp(gaze, size, size),
    "log-polar": lambda gaze, size: LogPolarWarp(gaze, SCREEN, size),
    "log-polar 1 rotate": lambda gaze, size: LogPolarWarp(gaze, SCREEN, size, "rotate", 1.0),
    "smooth": lambda gaze, size: VisualPolarWarp(gaze, SCREEN, size, e_max=12.0),
    "smooth rotate": lambda gaze, size: VisualPolarWarp(gaze, SCREEN, size, "rotate", e_max=12.0),
    "stair": lambda gaze, size: VisualPolarWarp(gaze, SCREEN, size, e_max=12.0, cut="stair", block=2),
    "stair rotate": lambda gaze, size: VisualPolarWarp(gaze, SCREEN, size, "rotate", e_max=12.0, cut="stair", block=2),
}
POLAR = [name for name in RASTERS if name != "screen"]
CUT = ["smooth", "smooth rotate", "stair", "stair rotate"]


def make_warp(name, gaze="per eye", size=(9, 11), dtype=torch.float64):
    """A small raster; an e_max of 12 degrees cuts half of its columns."""
    return RASTERS[name](Gaze(torch.tensor(GAZES[gaze], dtype=dtype)), size)


def polar_frame(warp, *, dirty=True, **options):
    """A frame in the cells of a warp. What is no cell holds what would spoil anything that read it."""
    frame = in_raster(make_frame(warp.view_count, *warp.resolution, **options), warp)
    return spoiled(frame) if dirty else frame


def in_raster(frame: Frame, warp) -> Frame:
    return replace(frame, warp=warp, gaze=warp.gaze)


def spoiled(frame):
    """The frame with values that are no numbers in the places that are no cells."""

    def spoil(plane):
        return torch.where(frame.warp.exists, plane, torch.nan) if plane.is_floating_point() else plane

    light = {name: spoil(getattr(frame, name)) for name in ("direct", "indirect", "emission")}
    guides = {name: spoil(getattr(frame.gbuffer, name)) for name in ("albedo", "normal", "position", "depth")}
    counts = torch.where(frame.warp.exists, frame.counts, 7)
    return replace(frame, **light, counts=counts, gbuffer=replace(frame.gbuffer, **guides))


def constant(frame, value=0.3):
    """Constant light on constant guides, with the frame's holes."""
    g, sampled = frame.gbuffer, frame.counts > 0
    half = torch.full_like(g.albedo, 0.5)
    surface = {"albedo": half, "normal": half, "position": half, "depth": half[:, :1], "prim": torch.zeros_like(g.prim)}
    nothing = torch.zeros_like(half)
    light = {"direct": value * torch.ones_like(half) * sampled, "indirect": nothing, "emission": nothing}
    return replace(frame, **light, gbuffer=replace(g, **surface))
