"""The Gaussian process of the contacts against hand-checked values, a dense solve, finite differences, scikit-learn."""

import copy
import itertools
import logging

import numpy as np
import pytest

from touchnet.data import GaussianProcess

KERNELS = ["rbf", "matern32", "matern52", "thin_plate"]


def contacts(n: int, seed: int = 0) -> np.ndarray:
    points = np.random.default_rng(seed).standard_normal((n, 3))
    return 0.4 * points / np.linalg.norm(points, axis=1, keepdims=True)


def process(kernel: str, noise: float = 1e-2, length_scale: float = 0.3, **kwargs) -> GaussianProcess:
    scale = 4.0 if kernel == "thin_plate" else length_scale
    return GaussianProcess(kernel, length_scale=scale, noise=noise, **kwargs)


def dense_kernel(kernel: str, a: np.ndarray, b: np.ndarray, scale: float) -> np.ndarray:
    r = np.linalg.norm(a[:, None] - b, axis=-1)
    if kernel == "rbf":
        return np.exp(-(r**2) / (2 * scale**2))
    if kernel == "matern32":
        return (1 + np.sqrt(3) * r / scale) * np.exp(-np.sqrt(3) * r / scale)
    if kernel == "matern52":
        return (1 + np.sqrt(5) * r / scale + 5 * r**2 / (3 * scale**2)) * np.exp(-np.sqrt(5) * r / scale)
    return (2 * r**3 - 3 * scale * r**2 + scale**3) / scale**3


def differences(function, x: np.ndarray, h: float = 1e-5) -> np.ndarray:
    columns = [(function(x + h * e) - function(x - h * e)) / (2 * h) for e in np.eye(3)]
    return np.stack(columns, axis=1)


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Degrees between two vectors."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


@pytest.mark.parametrize("kernel", KERNELS)
def test_no_contact_leaves_the_prior(kernel):
    gp = process(kernel)
    x = contacts(3)
    assert gp.mean(x).tolist() == [1, 1, 1]
    assert gp.variance(x).tolist() == [1, 1, 1]
    assert gp.variance_gradient(x).tolist() == [[0, 0, 0]] * 3
    assert gp.mean_gradient(x).tolist() == [[0, 0, 0]] * 3


def test_one_contact_by_hand():
    # k = 1, G = 1 + 0.5² = 1.25: mean = 1 - 1/1.25, variance = 1 - 1/1.25. At distance = length scale k = e^-1/2.
    gp = GaussianProcess("rbf", length_scale=2.0, noise=0.5)
    gp.add([1.0, 2.0, 3.0])
    at = np.array([[1.0, 2.0, 3.0], [1.0, 4.0, 3.0], [1e3, 0.0, 0.0]])
    np.testing.assert_allclose(gp.mean(at), [0.2, 1 - np.exp(-0.5) / 1.25, 1], rtol=1e-14)
    np.testing.assert_allclose(gp.variance(at), [0.2, 1 - np.exp(-1) / 1.25, 1], rtol=1e-14)
    # dk/dy = -k (y - y0) / l² = -e^-1/2 / 2; dV/dy = -2 k / 1.25 dk/dy = e^-1 / 1.25
    np.testing.assert_allclose(gp.variance_gradient(at)[1], [0, np.exp(-1) / 1.25, 0], rtol=1e-14, atol=1e-16)


@pytest.mark.parametrize("kernel", KERNELS)
def test_equals_a_dense_solve(kernel):
    gp, points, x = process(kernel), contacts(150), contacts(70, seed=1) * 1.1
    values = np.random.default_rng(2).uniform(-1, 1, 150)
    gp.add(points, values)
    k = dense_kernel(kernel, x, points, gp.length_scale)
    covariance = dense_kernel(kernel, points, points, gp.length_scale) + 1e-4 * np.eye(150)
    np.testing.assert_allclose(gp.mean(x), 1 + k @ np.linalg.solve(covariance, values - 1), rtol=0, atol=1e-8)
    variance = 1 - (k * np.linalg.solve(covariance, k.T).T).sum(1)
    np.testing.assert_allclose(gp.variance(x), variance, rtol=0, atol=1e-8)
    sign, logdet = np.linalg.slogdet(covariance)
    expected = -0.5 * ((values - 1) @ np.linalg.solve(covariance, values - 1) + logdet + 150 * np.log(2 * np.pi))
    assert sign == 1 and gp.log_marginal_likelihood() == pytest.approx(expected, abs=1e-6)
    assert gp.jitter == 0


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("n", [1, 2, 7, 40])
def test_gradients_equal_finite_differences(kernel, n):
    gp, x = process(kernel, noise=0.05), contacts(11, seed=3) * 1.2
    gp.add(contacts(n), np.linspace(-0.5, 0.5, n))
    np.testing.assert_allclose(gp.variance_gradient(x), differences(gp.variance, x), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(gp.mean_gradient(x), differences(gp.mean, x), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("kernel", KERNELS)
def test_one_by_one_in_blocks_and_reserved_are_the_same(kernel):
    points, x = contacts(90), contacts(5, seed=1)
    whole, single, reserved = process(kernel), process(kernel), process(kernel)
    whole.add(points)
    for point in points:
        single.add(point)
    reserved.reserve(90)
    for block in np.array_split(points, 7):
        reserved.add(block)
    for other in (single, reserved):
        assert len(other) == 90
        np.testing.assert_array_equal(other.points, points)
        np.testing.assert_array_equal(other.mean(x), whole.mean(x))
        np.testing.assert_array_equal(other.variance(x), whole.variance(x))


def test_add_with_gradient_is_add_and_the_gradient_before_it():
    points = contacts(60)
    gp, other = process("rbf"), process("rbf")
    for point in points:
        expected_variance, expected = other.variance(point[None])[0], other.variance_gradient(point[None])[0]
        variance, gradient = gp.add_with_gradient(point)
        other.add(point)
        assert variance == pytest.approx(expected_variance, abs=1e-12)
        np.testing.assert_allclose(gradient, expected, atol=1e-10)
    x = contacts(9, seed=4)
    np.testing.assert_array_equal(gp.variance(x), other.variance(x))


@pytest.mark.parametrize("kernel", KERNELS)
def test_gradient_after_a_contact_is_noise_over_pivot_times_that_before(kernel):
    gp = process(kernel, noise=0.1)
    gp.add(contacts(30))
    point = contacts(1, seed=8)[0]
    variance, gradient = gp.add_with_gradient(point)
    np.testing.assert_allclose(gp.variance_gradient(point[None])[0], gradient * 0.01 / (variance + 0.01), atol=1e-10)


@pytest.mark.parametrize("kernel", ["matern32", "matern52", "rbf"])
def test_direction_at_a_contact_is_stable_over_the_noise(kernel):
    # a stroke along x beside an older one: the direction points ahead and away from the older stroke
    stroke = np.arange(12)[:, None] * [0.02, 0.0, 0.0]
    older = stroke + np.array([0.0, 0.05, 0.0])
    directions = []
    for noise in (1e-1, 1e-2, 1e-3, 1e-4):  # σ_n² from 1e-2 to 1e-8
        gp = GaussianProcess(kernel, length_scale=0.15, noise=noise)
        gp.add(older)
        for point in stroke:
            variance, gradient = gp.add_with_gradient(point)
        assert np.isfinite(gradient).all() and np.linalg.norm(gradient) * 0.15 > 1e-3 * variance
        assert gradient[0] > 0 and gradient[1] < 0
        directions.append(gradient / np.linalg.norm(gradient))
    # the posterior itself turns a little with the noise; rounding must not
    assert max(angle(a, b) for a, b in itertools.pairwise(directions)) < 30


@pytest.mark.parametrize("noise", [1e-1, 1e-3, 1e-4])
def test_direction_at_a_contact_equals_extended_precision(noise):
    mp = pytest.importorskip("mpmath")
    stroke = np.concatenate([np.arange(8)[:, None] * [0.02, 0.001, 0.0], np.arange(9)[:, None] * [0.02, -0.03, 0.01]])
    gp = GaussianProcess("rbf", length_scale=0.15, noise=noise)
    for point in stroke:
        _, gradient = gp.add_with_gradient(point)
    with mp.workdps(50):
        points = [[mp.mpf(float(c)) for c in row] for row in stroke]

        def k(a, b):
            return mp.exp(-sum((u - v) ** 2 for u, v in zip(a, b, strict=True)) / (2 * mp.mpf(0.15) ** 2))

        n = len(points) - 1
        covariance = mp.matrix(n, n)
        for i in range(n):
            for j in range(n):
                covariance[i, j] = k(points[i], points[j]) + (mp.mpf(noise) ** 2 if i == j else 0)
        row = mp.matrix([k(points[-1], p) for p in points[:-1]])
        weights = mp.lu_solve(covariance, row)
        expected = np.zeros(3)
        for axis in range(3):
            terms = [
                2 * weights[j] * row[j] * (points[-1][axis] - points[j][axis]) / mp.mpf(0.15) ** 2 for j in range(n)
            ]
            expected[axis] = float(sum(terms))
    assert angle(gradient, expected) < 1e-3


@pytest.mark.parametrize("kernel", KERNELS)
def test_variance_falls_with_every_contact_and_stays_positive(kernel):
    gp, x = process(kernel, noise=1e-3), contacts(30, seed=6)
    previous = gp.variance(x)
    for point in contacts(60):
        gp.add(point)
        variance = gp.variance(x)
        assert (variance <= previous + 1e-12).all() and (variance >= 0).all()
        previous = variance
    assert (gp.variance(contacts(60)) <= 1.001e-6).all()


@pytest.mark.parametrize(
    ("kernel", "nu"), [("rbf", None), ("matern32", 1.5), ("matern52", 2.5)], ids=["rbf", "matern32", "matern52"]
)
def test_equals_scikit_learn(kernel, nu):
    process_module = pytest.importorskip("sklearn.gaussian_process")
    sk = process_module.kernels
    points, x = contacts(100), contacts(20, seed=1) * 1.2
    values = np.sin(7 * points[:, 0])
    covariance = sk.RBF(0.3) if nu is None else sk.Matern(0.3, nu=nu)
    peer = process_module.GaussianProcessRegressor(covariance, alpha=1e-4, optimizer=None).fit(points, values - 1)
    mean, deviation = peer.predict(x, return_std=True)
    gp = process(kernel)
    gp.add(points, values)
    np.testing.assert_allclose(gp.mean(x), mean + 1, atol=1e-8)
    np.testing.assert_allclose(gp.variance(x), deviation**2, atol=1e-8)
    expected = peer.log_marginal_likelihood(covariance.theta)
    assert gp.log_marginal_likelihood() == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-3])
def test_duplicate_touch_is_absorbed(shared_data, kernel, noise):
    """G01: the same place touched again leaves the fit as it was."""
    points = np.loadtxt(shared_data / "cases" / "G01_duplicate_touch.xyz")
    distinct = np.unique(points, axis=0)
    assert len(points) == 22 and len(distinct) == 20
    gp, other = process(kernel, noise), process(kernel, noise)
    gp.add(points)
    other.add(distinct)
    x = np.concatenate([distinct, contacts(40, seed=1) * 1.3])
    np.testing.assert_allclose(gp.mean(x), other.mean(x), atol=1e-3)
    assert (gp.variance(x) <= other.variance(x) + 1e-9).all()
    assert (gp.jitter > 0) == (noise == 0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("noise", [0.0, 1e-6, 1e-4, 1e-3])
@pytest.mark.parametrize("kernel", KERNELS)
def test_dense_slide_fits_with_reported_jitter(shared_data, kernel, noise, dtype, caplog):
    """G03: 400 contacts on 0.05, far below the length scale."""
    points = np.loadtxt(shared_data / "cases" / "G03_dense_slide_400.xyz").astype(dtype)
    gp = process(kernel, noise)
    with caplog.at_level(logging.INFO, logger="touchnet"):
        gp.add(points)
    assert len(gp) == 400
    x = np.concatenate([points, points[::50] + np.array([0.0, 0.05, 0.0])])
    mean, variance, gradient = gp.mean(x), gp.variance(x), gp.variance_gradient(x)
    assert np.isfinite(mean).all() and np.isfinite(gradient).all()
    np.testing.assert_allclose(mean[:400], 0, atol=1e-3)
    assert (variance >= 0).all() and (variance[:400] <= max(noise**2, 1e-4)).all()
    assert gp.jitter <= 1e-9
    assert bool(caplog.records) == (gp.jitter > 0)
    if kernel == "rbf" and noise == 0:
        assert gp.jitter > 0 and "jitter" in caplog.text


def test_thin_plate_asks_for_a_radius_that_covers_everything():
    gp = GaussianProcess("thin_plate", length_scale=1.0, noise=1e-3)
    gp.add([[0.0, 0.0, 0.0], [0.5, 0.5, 0.5]])
    with pytest.raises(ValueError, match=r"length_scale .* diagonal of the box .* 1 for a diagonal of 1\.73"):
        gp.add([1.0, 1.0, 1.0])
    with pytest.raises(ValueError, match="length_scale"):
        gp.variance([[-0.5, 0.0, 0.0], [-0.5, -0.5, 0.0]])
    assert len(gp) == 2


def test_offset_points_give_the_mean_a_sign_and_an_outward_gradient():
    points = contacts(80)
    normals = points / 0.4
    gp = process("rbf", length_scale=0.2)
    gp.add(points, normals=normals, offset=0.1)
    assert len(gp) == 240
    assert gp.mean(points * 1.2).min() > 0.5 and gp.mean(points * 0.8).max() < -0.5
    gradient = gp.mean_gradient(points)
    cosine = (gradient * normals).sum(1) / np.linalg.norm(gradient, axis=1)
    assert cosine.min() > 0.9


@pytest.mark.parametrize("kernel", ["rbf", "matern32", "matern52"])
def test_fit_finds_the_parameters_of_a_drawn_field(kernel):
    rng = np.random.default_rng(5)
    points = rng.uniform(-0.5, 0.5, (250, 3))
    covariance = dense_kernel(kernel, points, points, 0.25) + 0.1**2 * np.eye(250)
    gp = GaussianProcess(kernel, length_scale=0.6, noise=0.2)
    gp.add(points, 1 + np.linalg.cholesky(covariance) @ rng.standard_normal(250))
    fitted = gp.fit()
    assert fitted.length_scale == pytest.approx(0.25, rel=0.3)
    assert fitted.noise == pytest.approx(0.1, rel=0.5)
    best = fitted.log_marginal_likelihood()
    assert best > gp.log_marginal_likelihood()
    for factor in (0.9, 1.1):
        for change in ({"length_scale": factor}, {"noise": factor}):
            other = GaussianProcess(
                kernel,
                length_scale=fitted.length_scale * change.get("length_scale", 1),
                noise=fitted.noise * change.get("noise", 1),
            )
            other.add(points, gp.values)
            assert other.log_marginal_likelihood() < best
    bounded = gp.fit(length_scale=(0.5, 0.7), noise=(0.07, 0.07))
    assert bounded.length_scale == pytest.approx(0.5) and bounded.noise == pytest.approx(0.07)


def test_a_copy_grows_apart():
    gp = process("rbf")
    gp.add(contacts(20))
    twin = copy.deepcopy(gp)
    twin.add(contacts(200, seed=1))
    fresh = process("rbf")
    fresh.add(contacts(20))
    x = contacts(4, seed=2)
    assert len(gp) == 20
    np.testing.assert_array_equal(gp.variance(x), fresh.variance(x))


def test_empty_query():
    gp = process("rbf")
    gp.add(contacts(3))
    empty = np.zeros((0, 3))
    assert gp.mean(empty).shape == gp.variance(empty).shape == (0,)
    assert gp.mean_gradient(empty).shape == gp.variance_gradient(empty).shape == (0, 3)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: GaussianProcess("cubic", length_scale=1), "kernel should be one of rbf, matern32.* got 'cubic'"),
        (lambda: GaussianProcess(length_scale=0), "length_scale should be a positive number, got 0"),
        (lambda: GaussianProcess(length_scale=1, noise=-1), "noise should be a number ≥ 0 .* got -1"),
        (lambda: process("rbf").add(np.zeros((2, 2))), r"points should have shape \(M, 3\), got \(2, 2\)"),
        (lambda: process("rbf").add([np.nan, 0, 0]), "points should be finite"),
        (lambda: process("rbf").add([0, 0, 0], np.inf), "values should be finite"),
        (lambda: process("rbf").add([0, 0, 0], offset=0.1), "normals and offset go together"),
        (lambda: process("rbf").add_with_gradient(np.zeros((2, 3))), r"point should have shape \(3,\), got 2 points"),
        (lambda: process("rbf").last_gradient(), "last_gradient needs a contact, got none"),
        (lambda: process("rbf").mean(np.zeros((1, 4))), r"x should have shape \(M, 3\), got \(1, 4\)"),
        (lambda: process("thin_plate").fit(), "got 'thin_plate'"),
        (lambda: process("rbf").fit(), "fit needs at least 2 contacts, got 0"),
    ],
)
def test_errors_name_the_argument(call, words):
    with pytest.raises(ValueError, match=words):
        call()
