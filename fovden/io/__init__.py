"""Frames, references and pictures on disk.

Frames and references are multi-layer OpenEXR files in float32, so that any compositor or viewer opens them and nothing
is rounded or clipped. A channel is called ``layer.view.letter``; the beauty image has no layer (``R``, ``G``, ``B``)
and the default view, the first one, has no view part. Two views are called ``left`` and ``right``, more are called
``view0``, ``view1``, ...; the attribute ``multiView`` lists them. A frame holds

==========================  =====================================================================
``R G B``                   all of the light: direct + indirect + emission, for viewers
``direct. indirect.``       the parts of the light, ``R G B`` each
``emission.``
``spp.Y``                   samples of the pixel (``counts``), integers or floats as in the frame
``luminance_squared.Y``     mean of the samples' squared luminance
``layer.Y prim.Y``          the bits of the int32 values as unsigned integers: -1 reads 4294967295
``albedo.R G B``            the G-buffer, as in :class:`fovden.frame.GBuffer`
``N.X Y Z  P.X Y Z  Z``     normal, position, depth
``roughness.Y motion.X Y``
``barycentric.U V``
==========================  =====================================================================

and a reference ``R G B`` (its mean) and ``variance.R G B``; a denoised image has ``R G B`` alone. What is not an image
is in text attributes, JSON each, whose names start with ``fovden_``: ``camera``, ``gaze``, ``jitter``, ``index``,
``seed``, ``warp``, ``count``.

Files are written beside their place and moved there when complete: a reader never meets half a file.
"""

from fovden.io.exr import load_exr
from fovden.io.files import atomic_write
from fovden.io.frames import load_frame, save_frame
from fovden.io.images import load_image, load_reference, save_image, save_png, save_reference

__all__ = [
    "atomic_write",
    "load_exr",
    "load_frame",
    "load_image",
    "load_reference",
    "save_frame",
    "save_image",
    "save_png",
    "save_reference",
]
