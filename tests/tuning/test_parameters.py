"""Parameters survive the disk, and are refused where they do not belong."""

import json

import pytest
import torch

from fovden.filters import Atrous, NonHomogeneousAtrous, PredictedSigmas
from fovden.tuning import load_parameters, read_history, readable, save_parameters
from fovden.tuning.checkpoint import load_state, save_state


def test_parameters_come_back_to_the_bit(tmp_path):
    denoiser = NonHomogeneousAtrous(sigma_radiance=(1.1, 2.2, 3.3))
    save_parameters(denoiser, tmp_path / "p.safetensors", {"scene": "atrium"})
    other = NonHomogeneousAtrous()
    load_parameters(other, tmp_path / "p.safetensors")
    assert all(torch.equal(a, b) for a, b in zip(denoiser.parameters(), other.parameters(), strict=True))
    text = json.loads((tmp_path / "p.json").read_text())
    assert text["scene"] == "atrium"
    assert text["parameters"]["edge_stopping.1.sigma_radiance"] == pytest.approx(2.2)
    assert text["module"][""]["levels"] == [3, 4, 5]


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (lambda: NonHomogeneousAtrous((3, 4, 6)), r"levels: expected \[3, 4, 6\], as in the module, got \[3, 4, 5\]"),
        (lambda: NonHomogeneousAtrous(demodulate=True), r"demodulate: expected True"),
        (lambda: NonHomogeneousAtrous(schedule="constant"), r"edge_stopping\.0\.schedule: expected 'constant'"),
        (lambda: NonHomogeneousAtrous(guide="input"), r"options: expected .*guide='input'"),
        (Atrous, r"class: expected 'Atrous', as in the module, got NonHomogeneousAtrous"),
    ],
)
def test_a_module_made_otherwise_is_refused_and_left(tmp_path, other, message):
    save_parameters(NonHomogeneousAtrous(sigma_radiance=2.0), tmp_path / "p.safetensors")
    module = other()
    before = readable(module)
    with pytest.raises(ValueError, match=message):
        load_parameters(module, tmp_path / "p.safetensors")
    assert readable(module) == before


def test_bad_files_are_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"p\.safetensors"):
        load_parameters(Atrous(), tmp_path / "p.safetensors")
    (tmp_path / "p.safetensors").write_bytes(b"\x00" * 40)
    with pytest.raises(ValueError, match=r"p\.safetensors: damaged, or not a safetensors file"):
        load_parameters(Atrous(), tmp_path / "p.safetensors")
    save_state(tmp_path / "p.safetensors", [1])
    with pytest.raises(ValueError, match=r"no description of a module"):
        load_parameters(Atrous(), tmp_path / "p.safetensors")
    (tmp_path / "history.csv").write_text("step,loss\n1,2\n")
    with pytest.raises(ValueError, match=r"history\.csv"):
        read_history(tmp_path)


@pytest.mark.parametrize("make", [torch.optim.Adam, torch.optim.LBFGS, torch.optim.RMSprop])
def test_optimizers_go_on_from_disk_to_the_same_bits(tmp_path, make):
    def closure_of(parameter, optimizer):
        def closure():
            optimizer.zero_grad()
            loss = (parameter - torch.tensor([1.0, -2.0])).pow(4).sum()
            loss.backward()
            return loss

        return closure

    whole = torch.nn.Parameter(torch.zeros(2))
    optimizer = make([whole], lr=0.1)
    for _ in range(6):
        optimizer.step(closure_of(whole, optimizer))
    first = torch.nn.Parameter(torch.zeros(2))
    optimizer = make([first], lr=0.1)
    for _ in range(3):
        optimizer.step(closure_of(first, optimizer))
    save_state(tmp_path / "s.safetensors", {"optimizer": optimizer.state_dict(), "parameter": first})
    state = load_state(tmp_path / "s.safetensors")
    second = torch.nn.Parameter(state["parameter"])
    optimizer = make([second], lr=0.1)
    optimizer.load_state_dict(state["optimizer"])
    for _ in range(3):
        optimizer.step(closure_of(second, optimizer))
    assert torch.equal(whole, second)


def test_what_cannot_be_saved_is_named(tmp_path):
    with pytest.raises(TypeError, match=r"state: expected tensors, .*, got set"):
        save_state(tmp_path / "s.safetensors", {"a": {1, 2}})
    assert not list(tmp_path.iterdir())


def test_a_network_is_left_out_of_what_is_read_with_its_biases():
    names = set(readable(PredictedSigmas(Atrous((2, 1)))))
    assert names == {f"inner.edge_stopping.{name}" for name in ("sigma_radiance", "sigma_normal", "sigma_position")}
