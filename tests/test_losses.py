import math

import pytest
import torch

from touchnet.losses import occupancy_loss


def test_squared_error_is_eq_5():
    logits = torch.tensor([[0.0, math.log(3)]])  # occupancy 0.5 and 0.75
    inside = torch.tensor([[1.0, 0.0]])
    assert occupancy_loss(logits, inside, "squared").item() == pytest.approx((0.5**2 + 0.75**2) / 2)


def test_cross_entropy():
    logits = torch.tensor([[0.0, math.log(3)]])
    inside = torch.tensor([[1.0, 0.0]])
    assert occupancy_loss(logits, inside).item() == pytest.approx(-(math.log(0.5) + math.log(0.25)) / 2)


def test_errors():
    with pytest.raises(ValueError, match=r"one shape, got \(1, 2\) and \(1, 3\)"):
        occupancy_loss(torch.zeros(1, 2), torch.zeros(1, 3))
    with pytest.raises(ValueError, match="kind should be"):
        occupancy_loss(torch.zeros(1, 2), torch.zeros(1, 2), "absolute")
