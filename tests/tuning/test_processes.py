"""Two processes give the parameters of one, but for rounding."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

SCRIPT = Path(__file__).with_name("fit_in_processes.py")


def run(folder, processes):
    folder.mkdir()
    launcher = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node", str(processes)] if processes else []
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, *launcher, str(SCRIPT), str(folder)],
        check=False,
        env=environment,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return folder


@pytest.mark.skipif(not torch.distributed.is_available(), reason="this PyTorch has no distributed package")
def test_two_processes_give_the_parameters_of_one(tmp_path):
    one = load_file(run(tmp_path / "one", 0) / "rank0of1.safetensors")
    folder = run(tmp_path / "two", 2)
    ranks = [load_file(folder / f"rank{rank}of2.safetensors") for rank in (0, 1)]
    for name, expected in one.items():
        assert torch.equal(ranks[0][name], ranks[1][name])
        assert torch.allclose(ranks[0][name], expected, rtol=1e-5, atol=1e-6)
    assert (folder / "fit" / "history.csv").is_file()
