"""Gaussian process implicit surface over contacts: posterior mean, variance and their gradients (eq. 6-7).

The contacts' covariance G = K + σ_n² I is never refitted: each contact appends one row to its Cholesky factor, O(n²).
"""

import logging
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import minimize

from touchnet.ops._ext import _C

__all__ = ["GaussianProcess"]

KernelName = Literal["rbf", "matern32", "matern52", "thin_plate"]
_KERNELS = {"rbf": 0, "matern32": 1, "matern52": 2, "thin_plate": 3}
_LANES = 8  # gp_lanes in csrc/gp.h: query points that share one pass over the factor
_BATCH = 64  # groups of _LANES solved at once; bounds the memory of a query

_log = logging.getLogger(__name__)


class GaussianProcess:
    """Gaussian process regression of a scalar field from contacts, prior variance 1.

    The prior mean is 1 (most of space is empty), a contact is the value 0 there. With X the contacts, y their values
    and G = K(X, X) + noise² I: f(x) = mean + k(x, X) G⁻¹ (y - mean), V(x) = k(x, x) - k(x, X) G⁻¹ k(X, x).

    Args:
        kernel: "rbf", "matern32", "matern52" or "thin_plate" (2r³ - 3Rr² + R³, divided by R³).
        length_scale: length scale of the kernel in the units of the points; for the thin plate its R, which must be at
            least the diagonal of the box of all contacts and query points (ValueError otherwise: beyond R the
            variance can go negative).
        noise: standard deviation σ_n of an observation, ≥ 0.
        mean: prior mean.

    All arrays are float64. Where contacts repeat or crowd until G is singular in double precision, the smallest jitter
    out of 1e-12, 1e-11, ... that cures it is added to its diagonal: logged, and reported in `jitter` (0: none). That is
    the one event that factorises anew; with noise ≥ 1e-5 it does not happen.
    """

    def __init__(
        self, kernel: KernelName = "rbf", *, length_scale: float, noise: float = 1e-3, mean: float = 1.0
    ) -> None:
        if kernel not in _KERNELS:
            raise ValueError(f"kernel should be one of {', '.join(_KERNELS)}, got {kernel!r}")
        if not (np.isfinite(length_scale) and length_scale > 0):
            raise ValueError(f"length_scale should be a positive number, got {length_scale}")
        if not (np.isfinite(noise) and noise >= 0):
            raise ValueError(f"noise should be a number ≥ 0 (a standard deviation), got {noise}")
        self.kernel: KernelName = kernel
        self.length_scale = float(length_scale)
        self.noise = float(noise)
        self.prior_mean = float(mean)
        self.jitter = 0.0
        self._n = 0
        self._weights: NDArray | None = None
        self._gradient = np.zeros(3)
        self._allocate(64)

    def __len__(self) -> int:
        return self._n

    @property
    def points(self) -> NDArray[np.float64]:
        """The contacts so far (n, 3)."""
        return self._points[: self._n].copy()

    @property
    def values(self) -> NDArray[np.float64]:
        """Their observed values (n,)."""
        return self._values[: self._n].copy()

    def reserve(self, n: int) -> None:
        """Makes room for n contacts in all, so that adding them does not move the factor."""
        if n > len(self._points):
            self._allocate(n)

    def add(
        self, points: ArrayLike, values: ArrayLike = 0.0, *, normals: ArrayLike | None = None, offset: float = 0.0
    ) -> None:
        """Adds contacts (m, 3) or (3,) with their values, one number or (m,): O(n²) each, in order.

        With outward unit `normals` (as points) and an `offset` > 0, each contact is followed by the value 1 at that
        distance outside it and -1 inside, which gives the mean a sign and a slope across the surface.
        """
        points = _checked(points, "points")
        values = np.broadcast_to(np.asarray(values, dtype=np.float64), len(points))
        if not np.isfinite(values).all():
            raise ValueError("values should be finite")
        if (normals is None) != (offset == 0):
            raise ValueError("normals and offset go together: give both or neither")
        if normals is not None:
            normals = _checked(normals, "normals")
            if normals.shape != points.shape:
                raise ValueError(f"normals should have shape {points.shape} as points, got {normals.shape}")
            if not (np.isfinite(offset) and offset > 0):
                raise ValueError(f"offset should be a positive distance, got {offset}")
            points = np.stack([points, points + offset * normals, points - offset * normals], 1).reshape(-1, 3)
            values = np.stack([values, np.ones_like(values), -np.ones_like(values)], 1).reshape(-1)
        self._check_extent(points)
        if self._n + len(points) > len(self._points):
            self._allocate(max(2 * len(self._points), self._n + len(points)))
        for point, value in zip(points, values, strict=True):
            self._append(point, float(value))

    def add_one(self, point: ArrayLike, value: float = 0.0) -> float:
        """Adds one contact (3,); returns the variance there just before it."""
        point = _checked(point, "point")
        if len(point) != 1:
            raise ValueError(f"point should have shape (3,), got {len(point)} points")
        self._check_extent(point)
        if self._n == len(self._points):
            self._allocate(2 * self._n)
        return self._append(point[0], float(value))

    def last_gradient(self) -> NDArray[np.float64]:
        """Gradient (3,) of the variance at the last contact, as it was just before that contact.

        Since then the gradient there is this one times σ_n² / (V + σ_n²), V being the variance before: the same
        direction however small σ_n is, where the difference of the posterior's two terms would lose it to rounding.
        """
        if self._n == 0:
            raise ValueError("last_gradient needs a contact, got none")
        return self._gradient.copy()

    def add_with_gradient(self, point: ArrayLike, value: float = 0.0) -> tuple[float, NDArray[np.float64]]:
        """`add_one` and `last_gradient`: the variance at the contact (3,) just before it, and its gradient (3,)."""
        return self.add_one(point, value), self.last_gradient()

    def mean(self, x: ArrayLike) -> NDArray[np.float64]:
        """Posterior mean (m,) at x (m, 3), eq. 6."""
        x = _checked(x, "x")
        self._check_extent(x)
        return self.prior_mean + self._kernel(x) @ self._mean_weights()

    def mean_gradient(self, x: ArrayLike) -> NDArray[np.float64]:
        """Gradient (m, 3) of the posterior mean at x (m, 3); on the surface it points outwards."""
        x = _checked(x, "x")
        self._check_extent(x)
        return self._weighted_slopes(x, np.broadcast_to(self._mean_weights(), (len(x), self._n)))

    def variance(self, x: ArrayLike) -> NDArray[np.float64]:
        """Posterior variance (m,) of the field (without the noise) at x (m, 3), eq. 7; never below 0."""
        x = _checked(x, "x")
        self._check_extent(x)
        parts = [self._solve(part)[0] for part in _parts(x)]
        return np.maximum(np.concatenate(parts), 0.0) if parts else np.zeros(0)

    def variance_gradient(self, x: ArrayLike) -> NDArray[np.float64]:
        """Gradient (m, 3) of the posterior variance at x (m, 3): -2 Σ_j (G⁻¹ k(X, x))_j ∂k(x, x_j)/∂x, eq. 8.

        At a contact it is of the order of σ_n²: `last_gradient` gives its direction exactly.
        """
        x = _checked(x, "x")
        self._check_extent(x)
        gradients = []
        for part in _parts(x):
            _, solved = self._solve(part)
            groups, n, _ = solved.shape
            _C.gp_backward_batch(self._factor.ctypes.data, n, groups, n, solved.ctypes.data)
            weights = solved.transpose(0, 2, 1).reshape(groups * _LANES, n)[: len(part)]
            gradients.append(-2 * self._weighted_slopes(part, weights))
        return np.concatenate(gradients) if gradients else np.zeros((0, 3))

    def log_marginal_likelihood(self) -> float:
        """Log density of the contacts' values under the prior."""
        diagonal = np.arange(self._n)
        pivots = self._factor[diagonal * (diagonal + 3) // 2]
        whitened = self._whitened[: self._n]
        return float(-0.5 * whitened @ whitened - np.log(pivots).sum() - 0.5 * self._n * np.log(2 * np.pi))

    def fit(
        self, length_scale: tuple[float, float] | None = None, noise: tuple[float, float] | None = None
    ) -> "GaussianProcess":
        """A process with the same contacts whose length scale and noise maximise the log marginal likelihood.

        Both are searched in logarithm between the bounds given (default: a tenth to ten times the present value; a
        present noise of 0 counts as 1e-6), from the present values, by L-BFGS with the analytic gradient: one dense
        factorisation, O(n³), a try. Contacts of the value 0 alone say little about the length scale; offset points
        (see `add`) do. The thin plate's R is not a length scale: ValueError.
        """
        if self.kernel == "thin_plate":
            raise ValueError("kernel should have a length scale to fit, got 'thin_plate'")
        if self._n < 2:
            raise ValueError(f"fit needs at least 2 contacts, got {self._n}")
        present = np.array([self.length_scale, max(self.noise, 1e-6)])
        bounds = []
        for name, given, value in zip(("length_scale", "noise"), (length_scale, noise), present, strict=True):
            low, high = (value / 10, value * 10) if given is None else given
            if not 0 < low <= high < np.inf:
                raise ValueError(f"{name} should be bounds 0 < low ≤ high, got {given}")
            bounds.append((np.log(low), np.log(high)))
        points = self._points[: self._n]
        square = ((points[:, None] - points) ** 2).sum(-1)
        residual = self._values[: self._n] - self.prior_mean

        def loss(log: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]]:
            scale, sigma = np.exp(log)
            value, derivative = _profile(self.kernel, square, scale)
            covariance = value + (sigma**2 + 1e-12) * np.eye(self._n)
            try:
                factor = cho_factor(covariance, lower=True)
            except LinAlgError:
                return 1e300, np.zeros(2)
            weights = cho_solve(factor, residual)
            inverse = cho_solve(factor, np.eye(self._n))
            pull = inverse - np.outer(weights, weights)
            gradient = 0.5 * np.array([(pull * derivative).sum(), 2 * sigma**2 * np.trace(pull)])
            return 0.5 * residual @ weights + np.log(np.diag(factor[0])).sum(), gradient

        start = np.log(present).clip(*np.transpose(bounds))
        best = np.exp(minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds).x)
        fitted = GaussianProcess(self.kernel, length_scale=best[0], noise=best[1], mean=self.prior_mean)
        fitted.add(points, self._values[: self._n])
        return fitted

    # -- the growing factor --------------------------------------------------------------------------------------

    def _allocate(self, capacity: int) -> None:
        n = self._n
        points, values, whitened = np.zeros((capacity, 3)), np.zeros(capacity), np.zeros(capacity)
        factor = np.empty(capacity * (capacity + 1) // 2)
        if n:
            points[:n], values[:n], whitened[:n] = self._points[:n], self._values[:n], self._whitened[:n]
            factor[: n * (n + 1) // 2] = self._factor[: n * (n + 1) // 2]
        self._points, self._values, self._whitened, self._factor = points, values, whitened, factor
        self._work = np.empty(4 * capacity)

    def _append(self, point: NDArray[np.float64], value: float) -> float:
        self._points[self._n], self._values[self._n] = point, value
        while (variance := self._try_row(self._n)) is None:
            self._raise_jitter()
        self._n += 1
        self._weights = None
        return max(variance, 0.0)

    def _raise_jitter(self) -> None:
        while True:
            self.jitter = 10 * self.jitter if self.jitter else 1e-12
            _log.info("contact %d: singular in double precision, jitter raised to %.0e", self._n, self.jitter)
            if all(self._try_row(row) is not None for row in range(self._n)):
                return

    def _try_row(self, n: int) -> float | None:
        """Row n of the factor from rows 0..n; the variance at contact n before it, None where the row has no pivot."""
        start = n * (n + 1) // 2
        factor, points = self._factor.ctypes.data, self._points.ctypes.data
        variance = _C.gp_touch(
            _KERNELS[self.kernel],
            self.length_scale,
            points,
            factor,
            n,
            points + 24 * n,
            factor + 8 * start,
            self._work.ctypes.data,
            self._gradient.ctypes.data,
        )
        nugget = self.noise**2 + self.jitter
        square = variance + nugget
        # In exact arithmetic the square is at least the nugget, and rounding stays well below 5e-13.
        if square < max(0.5 * nugget, 5e-13):
            return None
        pivot = square**0.5
        row = self._factor[start : start + n]
        self._factor[start + n] = pivot
        self._whitened[n] = (self._values[n] - self.prior_mean - row @ self._whitened[:n]) / pivot
        return variance

    def _mean_weights(self) -> NDArray[np.float64]:
        if self._weights is None:
            weights = self._whitened[: self._n].copy()
            _C.gp_backward(self._factor.ctypes.data, self._n, weights.ctypes.data)
            self._weights = weights
        return self._weights

    # -- queries -------------------------------------------------------------------------------------------------

    def _kernel(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.empty((len(x), self._n))
        _C.gp_kernel(
            _KERNELS[self.kernel],
            self.length_scale,
            x.ctypes.data,
            len(x),
            self._points.ctypes.data,
            self._n,
            out.ctypes.data,
        )
        return out

    def _solve(self, x: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Variance (m,) at x (m, 3), and L⁻¹ k(X, x) as (groups, n, _LANES)."""
        groups = -(-len(x) // _LANES)
        padded = np.zeros((groups * _LANES, 3))
        padded[: len(x)] = x
        variance = np.ones(groups * _LANES)
        solved = np.empty((groups, self._n, _LANES))
        _C.gp_extend(
            _KERNELS[self.kernel],
            self.length_scale,
            self._points.ctypes.data,
            self._factor.ctypes.data,
            0,
            self._n,
            padded.ctypes.data,
            groups,
            self._n,
            solved.ctypes.data,
            variance.ctypes.data,
        )
        return variance[: len(x)], solved

    def _weighted_slopes(self, x: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Σ_j weights[:, j] ∂k(x, x_j)/∂x, (m, 3), for weights (m, n)."""
        points, scale = self._points[: self._n], self.length_scale
        square = ((x[:, None] - points) ** 2).sum(-1)
        distance = np.sqrt(square)
        if self.kernel == "rbf":
            slope = -np.exp(-0.5 * square / scale**2) / scale**2
        elif self.kernel == "matern32":
            slope = -3 / scale**2 * np.exp(-np.sqrt(3) * distance / scale)
        elif self.kernel == "matern52":
            t = np.sqrt(5) * distance / scale
            slope = -5 / (3 * scale**2) * (1 + t) * np.exp(-t)
        else:
            slope = 6 / scale**2 * (distance / scale - 1)
        product = weights * slope
        return x * product.sum(1, keepdims=True) - product @ points

    def _check_extent(self, x: NDArray[np.float64]) -> None:
        if self.kernel != "thin_plate" or not len(x):
            return
        both = np.concatenate([x, self._points[: self._n]])
        diagonal = float(np.linalg.norm(both.max(0) - both.min(0)))
        if diagonal > self.length_scale * (1 + 1e-9):
            raise ValueError(
                "length_scale (R of the thin plate) should be at least the diagonal of the box of all points, "
                f"got {self.length_scale:g} for a diagonal of {diagonal:g}"
            )


def _profile(kernel: KernelName, square: NDArray[np.float64], scale: float) -> tuple[NDArray, NDArray]:
    """The kernel at squared distances, and its derivative by the logarithm of the length scale."""
    if kernel == "rbf":
        value = np.exp(-0.5 * square / scale**2)
        return value, value * square / scale**2
    t = np.sqrt((3 if kernel == "matern32" else 5) * square) / scale
    decay = np.exp(-t)
    if kernel == "matern32":
        return (1 + t) * decay, t**2 * decay
    return (1 + t + t**2 / 3) * decay, t**2 * (1 + t) / 3 * decay


def _checked(points: ArrayLike, name: str) -> NDArray[np.float64]:
    array = np.ascontiguousarray(np.atleast_2d(np.asarray(points, dtype=np.float64)))
    if array.ndim != 2 or array.shape[1] != 3:
        raise ValueError(f"{name} should have shape (M, 3), got {np.shape(points)}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} should be finite")
    return array


def _parts(x: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    size = _BATCH * _LANES
    return [x[i : i + size] for i in range(0, len(x), size)]
