import dataclasses

import pytest
import torch

from touchnet.config import MODELS, ModelConfig, model_config_from_dict
from touchnet.models import TouchNet
from touchnet.models.unet3d import parameter_count

SMALL = ModelConfig(grid=16, channels=(8, 8, 16, 16, 16))


def touches_on_sphere(n, *, batch=1, seed=0):
    generator = torch.Generator().manual_seed(seed)
    normals = torch.nn.functional.normalize(torch.randn(batch, n, 3, generator=generator), dim=2)
    return normals * 0.8, normals


def queries_in_cube(m, *, batch=1, seed=1):
    return torch.rand(batch, m, 3, generator=torch.Generator().manual_seed(seed)) * 2 - 1


@pytest.fixture
def model():
    torch.manual_seed(0)
    return TouchNet(SMALL).eval()


def test_paper_size_has_the_papers_parameters():
    with torch.device("meta"):
        assert parameter_count(TouchNet("paper")) == 72_682_625


def test_base_size_is_small():
    with torch.device("meta"):
        assert parameter_count(TouchNet("base")) <= 5_800_000


@pytest.mark.parametrize("sampling", ["trilinear", "addition"])
def test_occupancy_has_the_shape_of_the_queries_and_lies_in_0_1(sampling):
    torch.manual_seed(0)
    model = TouchNet(SMALL, sampling=sampling)
    touches, normals = touches_on_sphere(50, batch=2)
    occupancy = model(touches, queries_in_cube(30, batch=2), normals)
    assert occupancy.shape == (2, 30)
    assert occupancy.min() >= 0 and occupancy.max() <= 1


def test_paper_network_runs_forward_and_backward():
    torch.manual_seed(0)
    model = TouchNet("paper")
    touches, _ = touches_on_sphere(40, batch=2)
    model(touches, queries_in_cube(20, batch=2)).sum().backward()
    assert all(parameter.grad is not None for parameter in model.parameters())


def test_every_parameter_of_base_gets_a_gradient(model):
    touches, normals = touches_on_sphere(60)
    model.logits(touches, queries_in_cube(200), normals).pow(2).sum().backward()
    silent = [
        name for name, parameter in model.named_parameters() if parameter.grad is None or not parameter.grad.any()
    ]
    assert silent == []


def test_order_of_touches_does_not_matter(model):
    touches, normals = touches_on_sphere(300)
    order = torch.randperm(300, generator=torch.Generator().manual_seed(2))
    queries = queries_in_cube(500)
    moved = model(touches[:, order], queries, normals[:, order])
    assert (moved - model(touches, queries, normals)).abs().max() < 1e-6


def test_rows_of_nan_are_padding(model):
    touches, normals = touches_on_sphere(40)
    padded = torch.cat([touches, torch.full((1, 7, 3), torch.nan)], dim=1)
    padded_normals = torch.cat([normals, torch.zeros(1, 7, 3)], dim=1)
    queries = queries_in_cube(100)
    assert torch.equal(model(padded, queries, padded_normals), model(touches, queries, normals))


def test_no_normals_means_zero_normals(model):
    touches, _ = touches_on_sphere(40)
    queries = queries_in_cube(100)
    assert torch.equal(model(touches, queries), model(touches, queries, torch.zeros_like(touches)))


@pytest.mark.parametrize("sampling", ["trilinear", "addition"])
def test_decoding_without_gradients_gives_the_same_values(sampling):
    torch.manual_seed(0)
    model = TouchNet(SMALL, sampling=sampling).eval()
    touches, normals = touches_on_sphere(40)
    features, queries = model.encode(touches, normals), queries_in_cube(3000)
    with torch.inference_mode():
        quick = model.decode(features, queries)
    assert torch.allclose(quick, model.decode(features, queries), atol=1e-6)
    assert quick.shape == (1, 3000)


def measures_height(model, slope):
    """Gives the model a first decoder volume whose channel 0 is the height y, and a head whose logit is -slope y."""
    with torch.no_grad():
        for parameter in model.head.parameters():
            parameter.zero_()
        # The height travels as its positive and its negative part.
        model.head[0].weight[:2, 0] = torch.tensor([1.0, -1.0])
        for layer in (model.head[2], model.head[4]):
            layer.weight[:2, :2] = torch.eye(2)
        model.head[6].weight[0, :2] = torch.tensor([-slope, slope])
    axis = torch.linspace(-1, 1, 16)
    fine = torch.zeros(2, 8, 16, 16, 16)
    fine[:, 0] = axis[:, None]
    return [fine, torch.zeros(2, 8, 8, 8, 8), torch.zeros(2, 16, 4, 4, 4)]


@pytest.mark.parametrize(("slope", "length"), [(100.0, 0.5), (40.0, 0.5), (10.0, 0.125), (0.0, 0.0)])
def test_estimated_normals_point_out_of_the_field_and_fade_where_it_is_flat(model, slope, length):
    features = measures_height(model, slope)
    points = torch.tensor([[[0.1, 0.2, -0.3], [torch.nan, 0, 0], [-0.9, -0.8, 0.7]]] * 2)
    expected = torch.tensor([[[0, length, 0], [0, 0, 0], [0, length, 0]]] * 2)
    torch.testing.assert_close(model.normals_of(features, points), expected, atol=1e-4, rtol=0)
    one = [volume[:1] for volume in features]
    torch.testing.assert_close(model.normals_of(one, points[:1]), expected[:1], atol=1e-4, rtol=0)


def test_unknown_normals_are_those_of_a_first_pass(model, monkeypatch):
    monkeypatch.setattr("touchnet.models.touchnet.PASSES", 2)
    touches, normals = touches_on_sphere(40, batch=2)
    queries = queries_in_cube(100, batch=2)
    some = normals.clone()
    some[0, 10:] = 0  # the second sample has all of its normals
    first = model._encode(touches[:1], some[:1])
    completed = torch.cat([some[0, :10], model.normals_of(first, touches[:1])[0, 10:]])[None]
    expected = torch.cat([model(touches[:1], queries[:1], completed), model(touches[1:], queries[1:], normals[1:])])
    torch.testing.assert_close(model(touches, queries, some), expected, atol=1e-6, rtol=0)
    single_pass = TouchNet(dataclasses.replace(SMALL, estimate_normals=False)).eval()
    single_pass.load_state_dict(model.state_dict())
    assert not torch.allclose(single_pass(touches, queries, some)[0], expected[0], atol=1e-6)


def test_passes_go_on_until_the_normals_settle(model, monkeypatch):
    monkeypatch.setattr("touchnet.models.touchnet.SETTLED", 0.5)
    estimates = iter([0.0, 0.2, 0.4, 0.41])  # lengths along y: the third changes by less than 0.5 * 0.5
    seen = []

    def estimate(features, points):
        seen.append(next(estimates))
        return torch.tensor([0, seen[-1], 0]).expand(points.shape)

    monkeypatch.setattr(model, "normals_of", estimate)
    touches, normals = touches_on_sphere(40)
    model.encode(touches)
    assert seen == [0.0]  # zeros that stay zeros have settled
    estimates = iter([0.3, 0.4, 0.5])
    seen.clear()
    model.encode(touches)
    assert seen == [0.3, 0.4]
    seen.clear()
    monkeypatch.setattr("touchnet.models.touchnet.PASSES", 3)
    estimates = iter([0.5, -0.5, 0.5])
    model.encode(touches)
    assert seen == [0.5, -0.5]
    seen.clear()
    model.encode(touches, normals)
    assert seen == []


def test_training_sees_every_pass_by_key(model, monkeypatch):
    touches, _ = touches_on_sphere(40, batch=5)
    queries, keys = queries_in_cube(100, batch=5), torch.tensor([7, 0, 2, 4, 6])
    found = model.logits(touches, queries, torch.zeros_like(touches), keys)
    assert found.requires_grad
    seen = []
    for row, passes in enumerate([1, 2, 3, 4, 2]):
        monkeypatch.setattr("touchnet.models.touchnet.PASSES", passes)
        one = slice(row, row + 1)
        seen.append(model.logits(touches[one], queries[one])[0])
        torch.testing.assert_close(found[row], seen[-1])
    assert not torch.allclose(seen[0], seen[1])
    assert not torch.allclose(seen[1], seen[2])


def test_normals_change_the_field(model):
    touches, normals = touches_on_sphere(40)
    queries = queries_in_cube(100)
    assert not torch.allclose(model(touches, queries, normals), model(touches, queries, -normals))


def test_base_treats_each_sample_of_a_batch_alone(model):
    touches, normals = touches_on_sphere(40, batch=3)
    queries = queries_in_cube(100, batch=3)
    model.train()
    together = model(touches, queries, normals)
    alone = torch.cat([model(touches[i : i + 1], queries[i : i + 1], normals[i : i + 1]) for i in range(3)])
    assert torch.allclose(together, alone, atol=1e-6)


def test_grid_channels_place_the_surface_within_a_cell():
    # One contact a quarter of a cell above vertex (8, 8, 8) of a 17-vertex grid, its normal along +x.
    model = TouchNet(ModelConfig(grid=16, channels=(8, 8, 16, 16, 16)))
    cell = 2 / 15
    vertex = torch.tensor([-1 + 8 * cell] * 3)
    touches = (vertex + torch.tensor([0.25 * cell, 0, 0])).view(1, 1, 3)
    normals = torch.tensor([[[1.0, 0, 0]]])
    density, *offset, nx, ny, nz, height = model._grid(touches, normals)[0, :, 8, 8, 8].tolist()
    weight = 0.75 / (0.75 + 0.1)
    assert density == pytest.approx(torch.tensor(1.75).log().item(), abs=1e-5)
    assert offset == pytest.approx([0.25 * weight, 0, 0], abs=1e-4)
    assert [nx, ny, nz] == pytest.approx([weight, 0, 0], abs=1e-5)
    assert height == pytest.approx(0.25 * weight, abs=1e-4)


def test_state_survives_a_trip_through_a_dictionary():
    config = MODELS["paper"]
    assert model_config_from_dict({**vars(config), "channels": list(config.channels)}) == config
    with pytest.raises(ValueError, match=r"unknown fields \['colour'\]"):
        model_config_from_dict({"colour": 1})


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: TouchNet("huge"), "config should be one of .*'huge'"),
        (lambda: TouchNet("base", sampling="nearest"), "sampling should be .*'nearest'"),
        (lambda: TouchNet(ModelConfig(grid=50)), "config.grid should be a positive multiple of 16, got 50"),
        (lambda: TouchNet(ModelConfig(scales=6)), r"config.scales should lie in 1..5, got 6"),
        (lambda: TouchNet(SMALL)(torch.zeros(5, 3), torch.zeros(1, 5, 3)), r"touches should have shape \(B, N, 3\)"),
        (
            lambda: TouchNet(SMALL)(torch.zeros(1, 5, 3), torch.zeros(1, 5, 3), torch.zeros(1, 4, 3)),
            r"normals should have the shape of touches \(1, 5, 3\), got \(1, 4, 3\)",
        ),
    ],
)
def test_errors_name_the_argument(make, words):
    with pytest.raises(ValueError, match=words):
        make()
