"""What every denoiser is: a module that folds a frame, and perhaps a history, into an image."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

from torch import Tensor, nn

from fovden.frame import Frame

__all__ = ["Denoised", "Denoiser"]


class Denoised(NamedTuple):
    """What a denoiser returns.

    Attributes:
        image: Denoised linear radiance, shape (v, 3, h, w).
        history: What the denoiser wants to see again with the next frame; ``None`` for a spatial filter.

    Example:
        >>> import torch
        >>> Denoised(torch.zeros(2, 3, 4, 4)).history is None
        True
    """

    image: Tensor
    history: Any = None


class Denoiser(nn.Module, ABC):
    """A frame, and perhaps a history, in; an image, and perhaps a history, out.

    The module holds parameters and constant buffers, never the state of a sequence: what must survive until the
    next frame is returned as ``history`` and handed back by the caller. ``history=None`` means the first frame or
    a cut. Views never mix, the frame is left as it was, and equal arguments give equal results.

    Example:
        >>> import torch
        >>> from fovden.frame import Frame, GBuffer
        >>> class Identity(Denoiser):
        ...     def forward(self, frame, history=None):
        ...         return Denoised(frame.radiance)
        >>> frame = Frame.from_radiance(torch.ones(2, 3, 4, 4), GBuffer.empty(2, (4, 4)))
        >>> Identity()(frame).image.mean()
        tensor(1.)
    """

    __call__: Callable[..., Denoised]

    @abstractmethod
    def forward(self, frame: Frame, history: Any = None) -> Denoised:
        """Returns the denoised image of a frame, and the history for the next one.

        Args:
            frame: The noisy frame.
            history: What the previous call returned; ``None`` on the first frame and after a cut.

        Returns:
            Image and history.

        Example:
            >>> import torch
            >>> from fovden.filters import Atrous
            >>> from fovden.frame import Frame, GBuffer
            >>> frame = Frame.from_radiance(torch.ones(2, 3, 4, 4), GBuffer.empty(2, (4, 4)))
            >>> Atrous()(frame, history=None).image.shape
            torch.Size([2, 3, 4, 4])
        """
