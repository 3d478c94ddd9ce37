"""Denoising of foveated, path-traced stereo frames, differentiable, for virtual reality research.

A tracer turns a scene and a raster into noisy frames; foveation says where the raster puts its samples and how many
each pixel gets; a denoiser folds frames into images.

The packages are :mod:`fovden.tracer`, :mod:`fovden.foveation`, :mod:`fovden.filters` and :mod:`fovden.metrics`. The
records that travel between them are exported here: a :class:`Frame` with its :class:`GBuffer`, a :class:`Reference`,
a :class:`Camera` with the two views of a :class:`StereoCamera`, and a :class:`Gaze`.

Images are (v, c, h, w) float32 tensors of linear radiance; v counts views, the left eye first. Pixel (x, y) has its
centre at (x + 0.5, y + 0.5), x right, y down. The world is right-handed, y up, in metres.
"""

from __future__ import annotations

from importlib.metadata import version

from fovden.camera import Camera, Gaze, StereoCamera
from fovden.frame import Frame, GBuffer, Reference

__all__ = ["Camera", "Frame", "GBuffer", "Gaze", "Reference", "StereoCamera", "__version__"]

__version__ = version("fovden")
