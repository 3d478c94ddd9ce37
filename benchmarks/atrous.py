"""The fused à-trous filter beside the same filter composed of torch operations, and beside joint bilateral filters.

One level and five, forwards and with gradients, on random tensors of two views; every side gets float32 in the layout
that it likes best, and answers through its public call. Peers:

- ``eager``: :func:`fovden.filters.passes.compose`, the same filter in torch operations, which also is what the fused
  form is compared with for its values. With gradients it runs at half the size, where its memory still suffices.
- ``compiled``: the same under ``torch.compile``, where there is a C++ compiler (``--compile``; it takes minutes).
- ``kornia``: ``joint_bilateral_blur``, 5 x 5 taps side by side, one guide.
- ``opencv``: ``jointBilateralFilter``, a disc of 29 taps of 7 x 7, one guide of three channels.

Each call is made twice in a row, of which the second counts, so that no side pays for what another has left behind.

The last two filter something else, and are compared by pixels and taps per second. The share of the processor's peak
counts 56 operations a tap, though a pair of pixels needs the most of them once, against multiplications and additions
that wait for nothing, measured in the same run.

    python -m benchmarks.atrous
    python -m benchmarks.atrous --resolution 270 240 --quick
"""

from __future__ import annotations

import argparse
import multiprocessing
import statistics
import sys
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from typing import Any

import torch
from torch import Tensor

from benchmarks import harness, memory
from benchmarks.fma import peak
from benchmarks.harness import Table, alternate, available, compared, positive, say
from fovden.filters import NonHomogeneousAtrous
from fovden.filters.operator import run_passes
from fovden.filters.passes import Pass, PassOptions, begin, compose
from fovden.filters.taps import Sigmas

Call = Callable[[], object]

FLOPS_PER_TAP = 56
STEPS = (16, 8, 4, 2, 1)
"""Steps of the five levels, as the non-homogeneous denoiser's."""


class Images:
    """Random light, guides and masks, and three nested layers around the middle."""

    def __init__(self, views: int, height: int, width: int) -> None:
        generator = torch.Generator().manual_seed(0)

        def rand(channels: int) -> Tensor:
            return torch.rand(views, channels, height, width, generator=generator)

        self.radiance, self.position = rand(3), rand(3)
        self.normal = torch.nn.functional.normalize(rand(3) - 0.5, dim=1)
        self.full = torch.ones(views, 1, height, width)
        y, x = torch.arange(height)[:, None] - height / 2, torch.arange(width) - width / 2
        distance, inner = (y**2 + x**2).sqrt(), (height * width / 50) ** 0.5
        layer = (distance > inner).int() + (distance > 2 * inner).int()
        self.layer = layer.expand(views, 1, height, width)
        chance = torch.tensor([1.0, 0.75, 0.5])[self.layer.long()]
        self.sampled = (rand(1) < chance).float()
        self.pixels = views * height * width

    def run(self, form: Callable[..., Any], steps: Sequence[int], sigmas: Sequence[Any], mask: Tensor) -> Tensor:
        """The image after passes of some form."""
        passes = [Pass(step, Sigmas(*sigmas), level=level) for level, step in enumerate(steps)]
        state = begin(self.radiance, mask)
        image: Tensor = form(state, self.normal, self.position, passes, options=PassOptions()).image
        return image


def forwards(images: Images, steps: Sequence[int], form: Callable[..., Any]) -> Call:
    """A call without gradients."""

    def call() -> object:
        with torch.no_grad():
            return images.run(form, steps, (0.7, 0.5, 0.4), images.full)

    return call


def both_ways(images: Images, steps: Sequence[int], form: Callable[..., Any], mask: Tensor, everything: bool) -> Call:
    """A call with gradients of the widths and the radiance, or of the guides too."""
    leaves = [images.radiance, images.normal, images.position] if everything else [images.radiance]

    def call() -> object:
        sigmas = [torch.tensor(value, requires_grad=True) for value in (0.7, 0.5, 0.4)]
        for leaf in leaves:
            leaf.requires_grad_()
        try:
            return torch.autograd.grad(images.run(form, steps, sigmas, mask).sum(), [*sigmas, *leaves])
        finally:
            for leaf in leaves:
                leaf.requires_grad_(False)

    return call


def there_and_back(images: Images, mask: Tensor, everything: bool, factors: Tensor | None) -> tuple[Call, Call]:
    """A call forwards, without gradients, and one that takes the gradients of a graph that is there already."""
    guides = [images.radiance, images.normal, images.position]
    leaves = [each.clone().requires_grad_() for each in (guides if everything else guides[:1])]
    radiance, normal, position = [*leaves, *guides[len(leaves) :]]
    sigmas = [torch.tensor(value, requires_grad=True) for value in (0.7, 0.5, 0.4)]
    seed = torch.ones_like(images.radiance)

    def image() -> Tensor:
        passes = [Pass(1, Sigmas(*sigmas))]
        state = begin(radiance, mask)
        return run_passes(state, normal, position, passes, factors=factors, options=PassOptions()).image

    def forth() -> object:
        with torch.no_grad():
            return image()

    graph = image()
    return forth, lambda: torch.autograd.grad(graph, [*sigmas, *leaves], seed, retain_graph=True)


def peers_of(images: Images) -> dict[str, tuple[int, Call]]:
    """Joint bilateral filters: their taps, and a call for both views."""
    found: dict[str, tuple[int, Call]] = {}
    if find_spec("kornia") is not None:
        from kornia.filters import joint_bilateral_blur  # noqa: PLC0415  it takes seconds

        found["kornia"] = 25, lambda: joint_bilateral_blur(images.radiance, images.normal, 5, 0.5, (1.5, 1.5))
    if find_spec("cv2") is not None:
        import cv2  # noqa: PLC0415  the peer is optional

        cv2.setNumThreads(torch.get_num_threads())
        layout = [each.permute(0, 2, 3, 1).contiguous().numpy() for each in (images.radiance, images.normal)]
        pairs = list(zip(*layout, strict=True))
        call = cv2.ximgproc.jointBilateralFilter
        found["opencv"] = 29, lambda: [call(guide, noisy, 7, 0.5, 1.5) for noisy, guide in pairs]
    return found


def measure(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Returns one result for each comparison."""
    available("kornia", "cv2")
    threads = harness.threads()
    torch.set_num_threads(threads)
    height, width = options.resolution
    images, small = Images(2, height, width), Images(2, height // 2, width // 2)
    results: list[dict[str, Any]] = []

    def add(kind: str, on: Images, taps: int, own: Call, peers: dict[str, Call]) -> None:
        say(f"{kind}, {on.pixels} pixels")
        times = alternate({"fovden": own, **peers}, options.rounds, repeat=True)
        results.append({"kind": kind, "pixels": on.pixels, "taps": taps, "threads": threads, "times": times})

    for name, steps in (("one level", (1,)), ("five levels", STEPS)):
        own, eager = forwards(images, steps, run_passes), forwards(images, steps, compose)
        add(f"{name}, forwards", images, 25 * len(steps), own, {"eager": eager})
        if options.compile and len(steps) == 1:
            compiled = forwards(images, steps, torch.compile(compose, fullgraph=True))
            add(f"{name}, forwards", images, 25, own, {"compiled": compiled})
    for name, steps, on in (("one level", (1,), images), ("five levels", STEPS, small)):
        for which, everything in (("radiance and widths", False), ("everything", True)):
            own = both_ways(on, steps, run_passes, on.full, everything)
            peers = {"eager": both_ways(on, steps, compose, on.full, everything)}
            add(f"{name}, both ways, {which}", on, 25 * len(steps), own, peers)
    for name, mask, everything, factors in (
        ("radiance and widths", images.full, False, None),
        ("everything", images.full, True, None),
        ("everything, masked", images.sampled, True, None),
        ("everything, widths per pixel", images.full, True, torch.ones_like(images.radiance)),
    ):
        forth, back = there_and_back(images, mask, everything, factors)
        times = alternate({"fovden": back, "forwards": forth}, options.rounds, repeat=True)
        results.append({"kind": f"backwards, {name}", "pixels": images.pixels, "threads": threads, "times": times})
    wide = {"sigma_normal": 2.0, "sigma_position": 2.0}  # or random guides, alike nowhere, would leave holes
    levels = {"Base": NonHomogeneousAtrous.base(**wide), "NH3LD": NonHomogeneousAtrous.nh3ld(**wide)}
    calls = {name: _denoise(images, denoiser) for name, denoiser in levels.items()}
    say("NH3LD and Base")
    times = alternate({"fovden": calls["NH3LD"], "Base": calls["Base"]}, options.rounds, repeat=True)
    share = torch.bincount(images.layer.flatten(), minlength=3).double() / images.layer.numel()
    taps = float((share * torch.tensor([3.0, 4.0, 5.0])).sum() / 5)
    results.append(
        {"kind": "NH3LD over Base", "pixels": images.pixels, "threads": threads, "taps": taps, "times": times}
    )
    for name, (count, call) in peers_of(images).items():
        add(f"one level beside {name}", images, 25, forwards(images, (1,), run_passes), {name: call})
        results[-1]["peer_taps"] = count
    results.append({"kind": "peak", "flops": peak(threads), "threads": threads})
    if memory.is_known():
        results += [
            {"kind": "memory", "side": side, "gradients": gradients, "bytes": growth(side, gradients, height, width)}
            for side in ("fovden", "eager")
            for gradients in (False, True)
        ]
    return results


def growth(side: str, gradients: bool, height: int, width: int) -> int:
    """Returns by how many bytes a new process grows at most while it filters one level."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(_grow, (side, gradients, height, width))


def _grow(side: str, gradients: bool, height: int, width: int) -> int:
    form = run_passes if side == "fovden" else compose

    def call(images: Images) -> object:
        whole = (
            both_ways(images, (1,), form, images.full, everything=True) if gradients else forwards(images, (1,), form)
        )
        return whole()

    call(Images(2, 16, 16))  # loads what code there is
    images = Images(2, height, width)
    before = memory.settled()
    memory.forget_peak()
    call(images)
    return memory.peak() - before


def _denoise(images: Images, denoiser: NonHomogeneousAtrous) -> Call:
    def call() -> object:
        with torch.no_grad():
            return denoiser.filter(images.radiance, images.normal, images.position, images.sampled, images.layer)

    return call


def tables(data: harness.Data) -> list[Table]:
    """Returns what is faster, how fast it is, and what memory it takes."""
    timed = [each for each in data["results"] if "times" in each]
    peak_ = next(each["flops"] for each in data["results"] if each["kind"] == "peak")
    rows = []
    for each in timed:
        for peer, times in each["times"].items():
            if peer not in ("eager", "compiled", "Base"):
                continue
            own = each["times"]["fovden"]
            seconds = [f"{statistics.median(side['wall']):.3f}" for side in (own, times)]
            rows.append([each["kind"], f"{each['pixels']:,}", peer, *seconds, *compared(own, times)])
    header = ["filter", "pixels", "peer", "fovden, s", "peer, s", *harness.COMPARED]
    return [
        Table("The à-trous filter, fused and composed", header, rows),
        _ways(timed),
        _speeds(timed, peak_),
        _memory(data["results"]),
    ]


def _ways(timed: Sequence[dict[str, Any]]) -> Table:
    """How many times as long as the way forwards the way back takes."""
    rows = []
    for each in timed:
        if "forwards" in each["times"]:
            back, forth = (statistics.median(each["times"][side]["wall"]) for side in ("fovden", "forwards"))
            name = each["kind"].removeprefix("backwards, ")
            rows.append([name, f"{forth:.3f}", f"{back:.3f}", f"{back / forth:.2f}"])
    return Table("The way back of one level", ["gradients of", "forwards, s", "backwards, s", "ratio"], rows)


def _speeds(timed: Sequence[dict[str, Any]], peak_: float) -> Table:
    """Pixels and taps per second of one level."""
    rows = []
    for each in timed:
        peer = each["kind"].removeprefix("one level beside ")
        if peer not in each["times"]:
            continue
        for side, taps in (("fovden", each["taps"]), (peer, each["peer_taps"])):
            rate = each["pixels"] / statistics.median(each["times"][side]["wall"])
            share = f"{100 * rate * taps * FLOPS_PER_TAP / peak_:.0f} %" if side == "fovden" else ""
            rows.append([side, f"{taps}", f"{rate / 1e6:.1f}", f"{rate * taps / 1e6:,.0f}", *DESCRIBED[side], share])
    header = ["one level", "taps", "megapixels/s", "megataps/s", "guides", "mask", "gradients", "share of the peak"]
    return Table("Beside joint bilateral filters", header, rows)


DESCRIBED = {
    "fovden": ["radiance, normal, position", "yes", "all"],
    "kornia": ["one image", "no", "by autograd"],
    "opencv": ["one image", "no", "none"],
}


def _memory(results: Sequence[dict[str, Any]]) -> Table:
    rows = [
        [each["side"], "both ways" if each["gradients"] else "forwards", f"{each['bytes'] / 1e6:,.0f}"]
        for each in results
        if each["kind"] == "memory"
    ]
    return Table("Memory of one level", ["", "", "the process grew by at most, MB"], rows)


def note(data: harness.Data) -> str:
    """Returns what was measured."""
    height, width = data["config"]["resolution"]
    own = next(each for each in data["results"] if each["kind"] == "NH3LD over Base")
    return (
        f"Two views of {width} x {height} pixels, five levels with gradients on half of that in width and height. "
        f"Medians of {data['config']['rounds']} rounds; ratios within each round, above 1 where fovden is faster. "
        f"The taps of NH3LD are {own['taps']:.3f} of Base's. "
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the benchmark and returns the exit status."""
    parser = argparse.ArgumentParser(
        "atrous", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--resolution", type=positive, nargs=2, default=(1080, 960), metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--compile", action="store_true", help="compare with torch.compile too")
    return harness.run("atrous", parser, measure, tables, note, arguments)


if __name__ == "__main__":
    sys.exit(main())
