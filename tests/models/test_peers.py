"""The networks that TouchNet is compared with: shapes, padding, gradients, determinism, and what each is made of."""

import dataclasses

import pytest
import torch

from touchnet import ops
from touchnet.config import PEERS, ConvONetConfig, GRNetConfig, PointNet2Config, architecture_of, model_config_from_dict
from touchnet.losses import points_loss
from touchnet.models import ConvONet, GRNet, PointNet2, build_model
from touchnet.models.pointnet2 import _grouped, _interpolated
from touchnet.models.unet3d import parameter_count

SMALL = {
    "grnet": GRNetConfig(grid=16, channels=(4, 8, 8, 8), code=16, sparse=32, copies=2),
    "pointnet2": PointNet2Config(points=64, copies=2, noise=4, width=8, centres=(16, 4), radii=(0.5, 1), neighbours=8),
    "convonet": ConvONetConfig(grid=8, hidden=8, blocks=2),
}


def touches(n: int, batch: int = 2) -> torch.Tensor:
    generator = torch.Generator().manual_seed(n)
    return 0.8 * torch.nn.functional.normalize(torch.randn(batch, n, 3, generator=generator), dim=2)


def small(name: str) -> torch.nn.Module:
    torch.manual_seed(0)
    return build_model(SMALL[name])


@pytest.mark.parametrize("name", ["grnet", "pointnet2"])
def test_points_come_out_of_points(name: str) -> None:
    model = small(name).eval()
    clouds = model(touches(40))
    assert clouds[-1].shape == (2, {"grnet": 64, "pointnet2": 128}[name], 3)
    assert torch.equal(model.points(touches(40)), clouds[-1])  # the same every time
    assert not torch.equal(model(touches(40), None, torch.tensor([5, 6]))[-1], clouds[-1])


@pytest.mark.parametrize("name", ["grnet", "pointnet2"])
def test_a_few_touches_and_padding_are_enough(name: str) -> None:
    model = small(name).eval()
    padded = torch.cat([touches(5), torch.full((2, 3, 3), torch.nan)], dim=1)
    assert torch.equal(model.points(padded), model.points(touches(5)))
    assert torch.isfinite(model.points(padded)).all()
    with pytest.raises(ValueError, match="touches hold no finite row"):
        model(torch.full((1, 4, 3), torch.nan))


@pytest.mark.parametrize("name", ["grnet", "pointnet2", "convonet"])
def test_every_parameter_gets_a_gradient(name: str) -> None:
    model = small(name)
    if model.predicts == "points":
        value = sum(cloud.pow(2).sum() for cloud in model(touches(60), None, torch.tensor([1, 2])))
    else:
        # A residual block starts without its second half; a step from there every parameter counts.
        for block in (*model.point_blocks, *model.decoder_blocks):
            torch.nn.init.normal_(block.second.weight, std=0.1)
        value = model.logits(touches(60), touches(100) * 0.9, touches(60)).pow(2).sum()
    value.backward()
    silent = [key for key, parameter in model.named_parameters() if parameter.grad is None or not parameter.grad.any()]
    # A bias or weight in front of a batch norm may have none; nothing else.
    assert [key for key in silent if not key.endswith("bias")] == []


@pytest.mark.parametrize(("name", "kind"), [("grnet", "chamfer_gridding"), ("pointnet2", "chamfer")])
def test_training_moves_points_to_a_surface_that_was_barely_touched(name: str, kind: str) -> None:
    model, targets = small(name), touches(500)
    optimizer = torch.optim.Adam(model.parameters(), lr=5e-3)
    losses = []
    for step in range(30):
        loss = points_loss(model(touches(5), None, torch.tensor([step, -step])), targets, kind)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert sum(losses[-5:]) < 0.8 * sum(losses[:5])


def test_grnet_is_the_published_size() -> None:
    with torch.device("meta"):
        model = GRNet()
    # Encoder and decoder as TouchNet's but for one channel at the end; offsets 1792-1792-448-112-24.
    offsets = 1792 * 1792 + 1792 + 1792 * 448 + 448 + 448 * 112 + 112 + 112 * 24 + 24
    # What TouchNet's decoder (16 channels) and MLP have and GRNet's (one channel) has not.
    touchnet = (32 * 16 * 64 + 2 * 16) + (16 * 64 + 64 + 64 * 128 + 128 + 128 * 32 + 32 + 32 + 1)
    assert parameter_count(model) == 76_707_626
    assert parameter_count(model) == 72_682_625 - touchnet + (32 * 64 + 2) + offsets


def test_grnet_starts_from_points_of_the_reversed_grid_and_touches() -> None:
    model = small("grnet").eval()
    model.up[3][1].weight.data.zero_()  # the decoder adds nothing: the density is that of the touches
    sparse, _ = model(touches(6))
    cells = ops.gridding_reverse(ops.gridding(touches(6), 16), fill=float("nan"))
    for row in range(2):
        valid = torch.cat([touches(6)[row], cells[row][torch.isfinite(cells[row]).all(1)]])
        distance = (sparse[row][:, None] - valid).norm(dim=2)
        assert distance.min(dim=1).values.max() < 1e-6


def test_balls_hold_their_nearest_points_and_the_centre_for_missing_ones() -> None:
    cloud = torch.tensor([[[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [1.0, 0, 0]]])
    centres, balls = _grouped(cloud, 2, 0.15, 3)
    assert centres.tolist() == [[0, 3]]  # the farthest from the first
    assert balls.tolist() == [[[0, 1, 0], [3, 3, 3]]]


def test_features_are_interpolated_by_inverse_distance() -> None:
    coarse = torch.tensor([[[0.0, 0, 0], [1.0, 0, 0]]])
    fine = torch.tensor([[[0.25, 0, 0], [1.0, 0, 0]]])
    found = _interpolated(fine, coarse, torch.tensor([[[0.0], [8.0]]]))
    assert found.flatten().tolist() == pytest.approx([2.0, 8.0], abs=1e-4)


def test_pointnet2_displaces_each_touch() -> None:
    model = small("pointnet2").eval()
    torch.nn.init.zeros_(model.displacement[-1].weight)
    torch.nn.init.zeros_(model.displacement[-1].bias)
    assert torch.equal(model.points(touches(64)), touches(64).repeat_interleave(2, dim=1))


def test_convonet_treats_touches_as_a_set_and_its_samples_apart() -> None:
    model = small("convonet").eval()
    queries = touches(50) * 0.7
    values = model(touches(40), queries, touches(40))
    assert values.shape == (2, 50) and values.min() >= 0 and values.max() <= 1
    order = torch.randperm(40, generator=torch.Generator().manual_seed(1))
    assert torch.allclose(model(touches(40)[:, order], queries, touches(40)[:, order]), values, atol=1e-6)
    padded = torch.cat([touches(40), torch.full((2, 3, 3), torch.nan)], dim=1)
    normals = torch.cat([touches(40), torch.zeros(2, 3, 3)], dim=1)
    assert torch.allclose(model(padded, queries, normals), values, atol=1e-6)
    assert torch.allclose(model(touches(40)[1:], queries[1:], touches(40)[1:]), values[1:], atol=1e-6)


def test_convonet_pools_where_it_reads() -> None:
    model = ConvONet(ConvONetConfig(grid=8, hidden=8, blocks=2))
    vertex = torch.tensor([[[-1 + 2 * 3 / 7, 1.0, -1.0], [2.0, 0, 0]]])
    cell = model._cells(vertex, torch.ones(1, 2, dtype=torch.bool))
    assert cell.tolist() == [[(3 * 8 + 7) * 8 + 0, 8**3]]
    volume = model._pooled(torch.ones(1, 2, 8), cell, "mean")[:, :-1].transpose(1, 2).unflatten(2, (8, 8, 8))
    assert ops.trilinear_sample(volume.contiguous(), vertex[:, :1])[0, 0, 0].item() == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("name", sorted(PEERS))
def test_configurations_survive_a_trip_through_a_dictionary(name: str) -> None:
    config = PEERS[name]
    assert architecture_of(config) == name
    stored = {key: list(value) if isinstance(value, tuple) else value for key, value in vars(config).items()}
    assert model_config_from_dict(stored, name) == config
    with pytest.raises(ValueError, match="architecture 'vapour' is unknown"):
        model_config_from_dict(stored, "vapour")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: GRNet(GRNetConfig(grid=50)), "config.grid should be a positive multiple of 16, got 50"),
        (lambda: ConvONet(ConvONetConfig(grid=9)), "config.grid should be a multiple of 4 from 8 on, got 9"),
        (lambda: PointNet2(dataclasses.replace(SMALL["pointnet2"], radii=(1.0,))), "config.radii should be 2"),
        (lambda: small("convonet")(torch.zeros(5, 3), torch.zeros(1, 5, 3)), r"touches should have shape \(B, N, 3\)"),
    ],
)
def test_errors_name_the_argument(make, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        make()
