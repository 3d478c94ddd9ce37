"""A fit to be run by torchrun: writes the parameters that each rank ends with."""

import sys
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).parent))
from tuning_frames import clean_image, noisy_frame

from fovden import distributed
from fovden.filters import NonHomogeneousAtrous
from fovden.tuning import fit, save_parameters

if __name__ == "__main__":
    torch.set_num_threads(1)
    folder = Path(sys.argv[1])
    with distributed.joined():
        pairs = [(noisy_frame(seed), clean_image()) for seed in range(5)]
        denoiser = NonHomogeneousAtrous((1, 2))
        fit(denoiser, pairs[:4], held_out=pairs[4:], steps=12, batch_size=3, evaluate_every=4, folder=folder / "fit",
            progress=None)  # fmt: skip
        save_parameters(denoiser, folder / f"rank{distributed.rank()}of{distributed.world_size()}.safetensors")
