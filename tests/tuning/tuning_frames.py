"""Small noisy frames with what a filter meets: an edge, unsampled pixels, three layers."""

from dataclasses import replace

import torch

from fovden.frame import Frame, GBuffer


def noisy_frame(seed, size=24, views=1, dtype=torch.float32):
    """Noise of two brightnesses on two planes that meet; a third of the pixels has no sample."""
    generator = torch.Generator().manual_seed(seed)
    x = torch.linspace(-1, 1, size, dtype=dtype).expand(views, 1, size, size)
    y = x.transpose(2, 3)
    right = (x + 0.2 * y > 0).to(dtype)
    normal = torch.cat([0.5 * right + 0.1 * y, 0.1 * x, torch.ones_like(x)], 1)
    position = torch.cat([x, y, 2 + 0.3 * right * x], 1)
    gbuffer = replace(
        GBuffer.empty(views, (size, size)).to(dtype),
        normal=torch.nn.functional.normalize(normal, dim=1),
        position=position,
        depth=position[:, 2:],
        prim=torch.zeros(views, 1, size, size, dtype=torch.int32),
    )
    noise = torch.randn(views, 3, size, size, generator=generator, dtype=dtype)
    counts = (torch.rand(views, 1, size, size, generator=generator) > 1 / 3).to(dtype)
    layer = (x.square() + y.square()).sqrt().mul(3).floor().clamp(max=2).int()
    light = (0.3 + right) * (1 + 0.8 * noise).clamp(min=0)
    return Frame.from_radiance(light * counts, gbuffer, counts=counts, layer=layer)


def clean_image(size=24, views=1):
    """What those frames are without noise, almost: clamping adds a little."""
    x = torch.linspace(-1, 1, size).expand(views, 1, size, size)
    right = (x + 0.2 * x.transpose(2, 3) > 0).float()
    return (0.3 + right).expand(-1, 3, -1, -1).contiguous()
