import pytest
import torch

from touchnet.device import pick_device


def test_pick_device():
    assert pick_device("cpu") == torch.device("cpu")
    assert pick_device("auto").type in ("cpu", "cuda")
    with pytest.raises(ValueError, match='device should be "auto", "cpu" or "cuda", got \'meta\''):
        pick_device("meta")
    if not torch.cuda.is_available():
        with pytest.raises(ValueError, match="finds no CUDA device"):
            pick_device("cuda")
