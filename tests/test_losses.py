import math

import pytest
import torch

from touchnet.losses import gridding_loss, occupancy_loss, points_loss


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


def test_clouds_are_compared_by_eq_9_and_summed():
    targets = torch.tensor([[[0.0, 0, 0]]])
    clouds = [torch.tensor([[[0.3, 0, 0]]]), torch.tensor([[[0.0, 0.1, 0]]])]
    assert points_loss(clouds, targets).item() == pytest.approx(2 * 0.3**2 + 2 * 0.1**2)
    more = points_loss(clouds, targets, "chamfer_gridding").item()
    assert more == pytest.approx(0.2 + 0.1 * sum(gridding_loss(cloud, targets).item() for cloud in clouds))


def test_gridding_loss_is_the_mean_difference_of_the_densities():
    # Grid of 2: (-1, -1, -1) and (1, 1, 1) are vertices, so each point weighs 1 there; half a point each of two copies.
    cloud = torch.tensor([[[-1.0, -1, -1], [1, 1, 1]]], requires_grad=True)
    loss = gridding_loss(cloud, torch.tensor([[[-1.0, -1, -1]]]), size=2)
    assert loss.item() == pytest.approx((0.5 + 0.5) / 8)
    loss.backward()
    assert cloud.grad.any()


def test_clouds_have_losses_of_their_own():
    with pytest.raises(ValueError, match=r"kind should be .chamfer. or .chamfer_gridding., got .squared."):
        points_loss([torch.zeros(1, 1, 3)], torch.zeros(1, 1, 3), "squared")
    with pytest.raises(ValueError, match="kind should be"):
        occupancy_loss(torch.zeros(1, 2), torch.zeros(1, 2), "chamfer")
