"""The edge-avoiding à-trous wavelet filter of Dammertz, Sewtz, Hanika and Lensch (High Performance Graphics 2010).

Departures from the paper: taps outside the image are left out, where its shader clamps them, which would count edge
pixels more than once; a mask says which pixels may be read.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from fovden.checks import require, require_integer, require_number, require_shapes, require_tensor
from fovden.filters.edge_stopping import (
    SIGMA_NORMAL,
    SIGMA_POSITION,
    SIGMA_RADIANCE,
    EdgeStopping,
    Schedule,
    SigmaBy,
)
from fovden.filters.guided import GuidedDenoiser
from fovden.filters.holes import fill_holes
from fovden.filters.operator import run_passes
from fovden.filters.passes import GuideCurve, Pass, PassOptions, begin, holes_of, scale_widths
from fovden.filters.stack import TapKernel, hole_widths, plan_passes
from fovden.filters.taps import Border, Sigma, Sigmas
from fovden.foveation import Topology

__all__ = ["Atrous", "atrous_pass"]


def atrous_pass(
    radiance: Tensor,
    normal: Tensor,
    position: Tensor,
    mask: Tensor | None = None,
    step: int = 1,
    sigma_radiance: Sigma = 0.5,
    sigma_normal: Sigma = 0.3,
    sigma_position: Sigma = 0.2,
    region: Tensor | None = None,
    known: Tensor | None = None,
    kernel: Tensor | None = None,
) -> Tensor:
    """Returns the image after one masked, edge-avoiding pass of 5 x 5 taps that lie ``step`` pixels apart.

    With p the pixel, q = p + step (i, j) its taps, dc, dn and dx the differences of radiance, normal and position
    between p and q, a tap's weight is, literally,

        kernel(i, j) * mask(q) * exp(-|dc|^2 / sigma_radiance^2
                                     - |dn|^2 / (step sigma_normal)^2 - |dx|^2 / sigma_position^2)

    and the image is the weighted mean of ``radiance``. Exponents stop at -80. Taps outside the image are left out.
    Where the weights sum to 1e-20 or less the image is ``radiance``.

    The mask belongs to the tap, not to the pixel: a pixel with mask 0 is computed from its sampled neighbours and is
    not read by them. Since it has no radiance of its own to compare with, pass the mask as ``known`` in the first
    pass.

    Args:
        radiance: Linear radiance, shape (v, 3, h, w), float32 or float64. Values are not checked here, so that the
            call compiles; the modules do.
        normal: Unit normals, shape (v, 3, h, w). Only their difference matters: any three-channel guide will do.
        position: Positions, shape (v, 3, h, w), in the unit of ``sigma_position``.
        mask: Weight of each pixel as a tap, bool, or floating in [0, 1], shape (v, 1, h, w), where a size
            may be 1; ``None`` means 1.
        step: Distance between neighbouring taps in pixels, at least 1; may exceed the image.
        sigma_radiance: Width of radiance: a positive number, a scalar tensor, or a tensor of shape (v, 1, h, w), where
            a size may be 1; read at p.
        sigma_normal: Width of normals per pixel of step, the same way.
        sigma_position: Width of position, the same way.
        region: Where to filter, bool or floating, non-zero inside, shape as for ``mask``; elsewhere the input is
            copied. ``None`` means everywhere. The cost is that of the region.
        known: Where it is 0 the radiance term is dropped, shape as for ``mask``; ``None`` means known everywhere.
        kernel: Positive weights of the taps, shape (5,), whose outer product is taken, or (5, 5); ``None`` means the
            B3 spline (1/16, 1/4, 3/8, 1/4, 1/16).

    Returns:
        The filtered radiance, shape, type and device of ``radiance``; never the same memory.

    Raises:
        ShapeError: If the shapes disagree.
        TypeError: If ``radiance`` is neither float32 nor float64, or an argument has the wrong type.
        ValueError: If ``step`` is below 1 or a sigma given as a number is not positive.

    Differentiable: in radiance, normal, position, mask, kernel and sigmas, to second order, with finite gradients
    also where every weight underflows; not in ``region`` and ``known``. Cost: 25 taps of 10 planes,
    in one fused operation for float32 on the CPU, which keeps one plane for the way back; elsewhere, in torch
    operations, some 400 planes are kept (:func:`fovden.filters.operator.run_passes`).

    Source: Dammertz et al. 2010, section 3 and shader, with phi = sigma^2; the defaults are an example of magnitudes
    for radiance around 1 and positions in metres, since the paper gives none.

    Example:
        >>> radiance = torch.zeros(1, 3, 5, 5)
        >>> radiance[..., 2, 2] = 1.0
        >>> flat = torch.zeros(1, 3, 5, 5)
        >>> out = atrous_pass(radiance, flat, flat, sigma_radiance=1e6)
        >>> out[0, 0, 2] * 64
        tensor([2.1818, 6.4000, 9.0000, 6.4000, 2.1818])
    """
    sizes = require_shapes("v 3 h w", radiance=radiance, normal=normal, position=position)
    if radiance.dtype not in (torch.float32, torch.float64):
        raise TypeError(f"radiance: expected float32 or float64, got {radiance.dtype}")
    mask, region, known = (
        None if plane is None else _require_plane(name, plane, sizes)
        for name, plane in (("mask", mask), ("region", region), ("known", known))
    )
    sigmas = Sigmas(sigma_radiance, sigma_normal, sigma_position)
    for name, sigma in zip(Sigmas._fields, sigmas, strict=True):
        if not isinstance(sigma, Tensor):
            require_number(f"sigma_{name}", sigma, above=0)
        elif sigma.dim() > 0:
            _require_plane(f"sigma_{name}", sigma, sizes)
    if kernel is not None and kernel.dim() == 1:
        require_shapes("5", kernel=kernel)
        kernel = kernel[:, None] * kernel
    elif kernel is not None:
        require_shapes("5 5", kernel=kernel)
    state = begin(radiance, mask)
    everywhere = torch.ones((), dtype=torch.bool, device=radiance.device).expand_as(state.mask)
    state = state._replace(known=everywhere if known is None else known != 0)
    widths, factors = _factored(sigmas, state.mask)
    only = Pass(require_integer("step", step, minimum=1), widths, label=1 if region is not None else 0, kernel=kernel)
    region = None if region is None else region != 0
    options = PassOptions()
    return run_passes(state, normal, position, [only], region=region, factors=factors, options=options).image


def _factored(sigmas: Sigmas, plane: Tensor) -> tuple[Sigmas, Tensor | None]:
    """Widths that are the same everywhere, and what they are multiplied by at each pixel, if they are not."""
    differ = [isinstance(sigma, Tensor) and sigma.dim() > 0 for sigma in sigmas]
    if not any(differ):
        return sigmas, None
    pairs = list(zip(sigmas, differ, strict=True))
    factors = [
        torch.as_tensor(sigma, dtype=plane.dtype).expand_as(plane) if own else torch.ones_like(plane)
        for sigma, own in pairs
    ]
    return Sigmas(*(1.0 if own else sigma for sigma, own in pairs)), torch.cat(factors, 1)


def _require_plane(name: str, plane: Tensor, sizes: dict[str, int]) -> Tensor:
    """One value per pixel; any size may be 1 instead, and means the same value along that axis."""
    shape = require_tensor(name, plane).shape
    wanted = (sizes["v"], 1, sizes["h"], sizes["w"])
    fits = len(shape) == 4 and all(size in (1, full) for size, full in zip(shape, wanted, strict=True))
    if not fits:
        require_shapes("v 1 h w", sizes, **{name: plane})
    return plane.expand(-1, -1, sizes["h"], sizes["w"])


class Atrous(GuidedDenoiser):
    """The edge-avoiding à-trous filter over the pixels that were sampled.

    Passes of 5 x 5 taps follow each other with the given steps; each is :func:`atrous_pass`, and the width of
    radiance shrinks from pass to pass (:class:`fovden.filters.EdgeStopping`). Increasing steps are the paper's.
    Decreasing ones (Qi, Wu and He 2012, as the non-homogeneous denoiser uses them) end on a dense 5 x 5 window,
    which closes the lattice that the wide steps leave. N passes with steps 1 .. 2^(N-1) reach 2 (2^N - 1) pixels.

    Pixels without samples are filled from sampled ones in each pass, and are never read. The radiance of such a
    pixel weighs nothing until a pass has given it a value. What no tap reaches is filled at the end
    (:func:`fovden.filters.fill_holes`); a view without any sample stays as it was.

    Args:
        steps: Distances between taps in pixels, one per pass, in the order of the passes.
        sigma_radiance: Initial width of radiance in the first pass.
        sigma_normal: Initial width of normals at step 1.
        sigma_position: Initial width of position.
        schedule: How the width of radiance shrinks.
        sigma_by: Whether it shrinks with the number of the pass or with the scale of the step.
        border: Whether taps outside the image are left out or clamped to its edge, as in the paper's shader.
        fill_holes: Whether to fill what no tap has reached.
        relative: Whether to use the view's own units of radiance and length.
        demodulate: Whether to filter illumination in place of radiance.
        guide_curve: What is compared of radiance c: ``"linear"``, c, or ``"log"``, log(1 + c), c in the filter's units,
            so that widths mean ratios where it is bright. It shrinks differences: find the width of radiance anew. It
            is composed of torch operations (:func:`fovden.filters.operator.run_passes`).
        per_pass: Whether each pass has three widths of its own.
        learn_kernel: Whether each pass has a kernel of its own, which is learned (:class:`fovden.filters.TapKernel`).

    Raises:
        ValueError: If there is no step, one is below 1, or an option is not one of those listed.

    Example:
        >>> from fovden.frame import Frame, GBuffer
        >>> noisy = torch.rand(2, 3, 16, 16, generator=torch.Generator().manual_seed(0))
        >>> frame = Frame.from_radiance(noisy, GBuffer.empty(2, (16, 16)))
        >>> image = Atrous(steps=(4, 2, 1))(frame).image
        >>> bool(image.std() < noisy.std() / 2)
        True
    """

    def __init__(
        self,
        steps: Sequence[int] = (1, 2, 4, 8, 16),
        *,
        sigma_radiance: float = SIGMA_RADIANCE,
        sigma_normal: float = SIGMA_NORMAL,
        sigma_position: float = SIGMA_POSITION,
        schedule: Schedule = "halve_sigma",
        sigma_by: SigmaBy = "pass",
        border: Border = "skip",
        fill_holes: bool = True,
        relative: bool = True,
        demodulate: bool = False,
        guide_curve: GuideCurve = "linear",
        per_pass: bool = False,
        learn_kernel: bool = False,
    ) -> None:
        super().__init__(relative=relative, demodulate=demodulate)
        require(len(steps) > 0, "steps", steps, "at least one step")
        self.steps = tuple(require_integer("steps", step, minimum=1) for step in steps)
        count = len(self.steps)
        self.edge_stopping = EdgeStopping(
            sigma_radiance,
            sigma_normal,
            sigma_position,
            schedule=schedule,
            sigma_by=sigma_by,
            passes=count if per_pass else None,
        )
        self.register_module("kernel", TapKernel(count) if learn_kernel else None)
        self.options = PassOptions(border=border, guide_curve=guide_curve)
        self.fill_holes = fill_holes
        self.per_pass = per_pass
        self.learn_kernel = learn_kernel

    kernel: TapKernel | None

    def filter(
        self,
        radiance: Tensor,
        normal: Tensor,
        position: Tensor,
        mask: Tensor | None = None,
        layer: Tensor | None = None,
        factors: Tensor | None = None,
        topology: Topology | None = None,
    ) -> Tensor:
        """Returns the filtered radiance of plain tensors; see :meth:`fovden.filters.GuidedDenoiser.filter`.

        The layers are not used. ``factors``, shape (v, 3, h, w), positive, multiply the widths of radiance, normal and
        position at each pixel, in each pass and where holes are filled. Differentiable in them too. ``topology`` is the
        polar raster that the pixels are cells of; ``None`` means the screen.

        Example:
            >>> flat = torch.zeros(1, 3, 4, 4)
            >>> Atrous((1,)).filter(flat + 2, flat, flat, mask=torch.eye(4)[None, None]).mean()
            tensor(2., grad_fn=<MeanBackward0>)
        """
        del layer
        if factors is not None:
            require_shapes("v 3 h w", radiance=radiance, factors=factors)
        passes = plan_passes(self.steps, self.edge_stopping, self.kernel)
        start = begin(radiance, mask, topology)
        state = run_passes(start, normal, position, passes, factors=factors, options=self.options, topology=topology)
        holes = holes_of(state, topology)
        if not torch.compiler.is_compiling() and not bool(holes.any()):
            return state.image
        image = torch.where(state.has_value(), state.image, 0)
        if not self.fill_holes:
            return image
        widths = scale_widths(hole_widths(passes), factors)
        return fill_holes(
            image,
            holes,
            state.mask,
            normal,
            position,
            sigma_normal=widths.normal,
            sigma_position=widths.position,
            topology=topology,
        )

    def extra_repr(self) -> str:
        """Returns the steps, for ``print``.

        Example:
            >>> Atrous((2, 1)).extra_repr()
            'steps=(2, 1)'
        """
        return f"steps={self.steps}"
