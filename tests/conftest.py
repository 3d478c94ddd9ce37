"""Fixtures that every test may use."""

import os
import signal
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parent.parent

# A shell in the background starts its children deaf to Ctrl-C, and so are theirs, which the tests interrupt.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def shared_scenes() -> Path:
    """The folder of real scenes; tests that need it skip with a message where it is absent."""
    folder = Path(os.environ.get("FOVDEN_SCENES", ROOT.parent / "shared" / "scenes"))
    if not folder.is_dir():
        pytest.skip(f"the real scenes are not at {folder}; set FOVDEN_SCENES to their folder")
    return folder


@pytest.fixture
def threads():
    """Sets the number of threads; restored afterwards."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)
