import json
import pickle

import pytest
import torch
from safetensors.torch import save_file

from touchnet.config import ModelConfig
from touchnet.models import TouchNet
from touchnet.weights import load_model, save_weights

SMALL = ModelConfig(grid=16, channels=(8, 8, 16, 16, 16), scales=2)


@pytest.fixture
def model():
    torch.manual_seed(0)
    return TouchNet(SMALL)


def test_round_trip_keeps_weights_and_architecture(model, tmp_path):
    save_weights(model, tmp_path / "w.safetensors")
    loaded = load_model(tmp_path / "w.safetensors")
    assert loaded.config == SMALL and not loaded.training
    for name, value in model.state_dict().items():
        assert torch.equal(loaded.state_dict()[name], value), name


def test_half_precision_halves_the_file_and_loads_as_float32(model, tmp_path):
    save_weights(model, tmp_path / "full.safetensors")
    save_weights(model, tmp_path / "half.safetensors", half=True)
    sizes = [(tmp_path / f"{name}.safetensors").stat().st_size for name in ("half", "full")]
    assert sizes[0] < 0.55 * sizes[1]
    loaded = load_model(tmp_path / "half.safetensors")
    assert all(parameter.dtype == torch.float32 for parameter in loaded.parameters())
    for name, value in model.state_dict().items():
        assert torch.allclose(loaded.state_dict()[name], value, rtol=1e-3, atol=1e-6), name


def test_missing_file_names_the_path(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file .*nowhere"):
        load_model(tmp_path / "nowhere.safetensors")


def test_pickles_are_refused_unopened(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("the pickle was executed",))

    (tmp_path / "w.safetensors").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(ValueError, match="is not a safetensors file"):
        load_model(tmp_path / "w.safetensors")


def test_foreign_and_damaged_weights_are_refused(model, tmp_path):
    save_file({"a": torch.zeros(1)}, tmp_path / "foreign.safetensors")
    with pytest.raises(ValueError, match="was not written by touchnet"):
        load_model(tmp_path / "foreign.safetensors")
    header = {"format": "touchnet-weights", "config": json.dumps({"grid": 16})}
    save_file({"a": torch.zeros(1)}, tmp_path / "other.safetensors", metadata=header)
    with pytest.raises(ValueError, match="does not fit its own configuration"):
        load_model(tmp_path / "other.safetensors")
    save_weights(model, tmp_path / "cut.safetensors")
    whole = (tmp_path / "cut.safetensors").read_bytes()
    (tmp_path / "cut.safetensors").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match="is not a safetensors file"):
        load_model(tmp_path / "cut.safetensors")


def test_nothing_is_left_behind_when_saving_fails(model, tmp_path, monkeypatch):
    monkeypatch.setattr("touchnet.weights.save", lambda *_, **__: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        save_weights(model, tmp_path / "w.safetensors")
    assert list(tmp_path.iterdir()) == []
