"""Gaussian process implicit surface over contacts: posterior mean, variance and their gradients (eq. 6-7).

The contacts' covariance G = K + σ_n² I is never refitted: each contact appends one row to its Cholesky factor, O(n²).
"""

import logging
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

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
            least the largest distance between any two points ever used (an error names the distance otherwise:
            beyond R the variance can go negative).
        noise: standard deviation σ_n of an observation, ≥ 0.
        mean: prior mean.

    All arrays are float64. Contacts that repeat or crowd until G is numerically singular are absorbed: their own
    variance is raised by the smallest jitter out of 1e-12, 1e-11, ... that keeps the factor positive; `jitter` is the
    largest used and the first use is logged.
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

    def add(self, points: ArrayLike, values: ArrayLike = 0.0) -> None:
        """Adds contacts (m, 3) or (3,) with their values, one number or (m,): O(n²) each, in order."""
        points = _checked(points, "points")
        values = np.broadcast_to(np.asarray(values, dtype=np.float64), len(points))
        if not np.isfinite(values).all():
            raise ValueError("values should be finite")
        self._check_extent(points)
        if self._n + len(points) > len(self._points):
            self._allocate(max(2 * len(self._points), self._n + len(points)))
        for point, value in zip(points, values, strict=True):
            self._append(point, float(value))

    def add_with_gradient(self, point: ArrayLike, value: float = 0.0) -> tuple[float, NDArray[np.float64]]:
        """Adds one contact (3,); returns the variance there before it, and the gradient (3,) of that variance.

        One back-substitution. Afterwards the gradient at the contact is this one times σ_n² / (V + σ_n²), V being the
        variance returned: the same direction however small σ_n is, where differencing the two terms of the
        posterior gradient would lose it to rounding.
        """
        point = _checked(point, "point")
        if len(point) != 1:
            raise ValueError(f"point should have shape (3,), got {len(point)} points")
        self._check_extent(point)
        if self._n == len(self._points):
            self._allocate(2 * self._n)
        return self._append_with_gradient(point[0], value)

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

        At a contact it is of the order of σ_n²: `add_with_gradient` gives its direction exactly.
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

    # -- the growing factor --------------------------------------------------------------------------------------

    def _allocate(self, capacity: int) -> None:
        n = self._n
        points, values, whitened = np.zeros((capacity, 3)), np.zeros(capacity), np.zeros(capacity)
        factor = np.empty(capacity * (capacity + 1) // 2)
        if n:
            points[:n], values[:n], whitened[:n] = self._points[:n], self._values[:n], self._whitened[:n]
            factor[: n * (n + 1) // 2] = self._factor[: n * (n + 1) // 2]
        self._points, self._values, self._whitened, self._factor = points, values, whitened, factor
        self._work, self._gradient = np.empty(capacity), np.empty(3)
        # numpy takes as long to say an address as a short row takes to solve
        self._address = {
            name: getattr(self, f"_{name}").ctypes.data for name in ("points", "factor", "work", "gradient")
        }

    def _append(self, point: NDArray[np.float64], value: float) -> float:
        n, address = self._n, self._address
        offset = n * (n + 1) // 2
        self._points[n] = point
        variance = _C.gp_variance(
            _KERNELS[self.kernel],
            self.length_scale,
            address["points"],
            address["factor"],
            n,
            address["points"] + 24 * n,
            address["factor"] + 8 * offset,
        )
        square = variance + self.noise**2
        jitter = 0.0
        # In exact arithmetic the square is ≥ σ_n²; rounding takes up to about n units in the last place of k(x, x).
        while square + jitter < max(0.5 * self.noise**2, 0.5 * jitter, 1e-13):
            jitter = 10 * jitter if jitter else 1e-12
        if jitter > self.jitter:
            _log.info("contact %d: covariance is numerically singular, jitter %.0e added", n, jitter)
            self.jitter = jitter
        pivot = (square + jitter) ** 0.5
        row = self._factor[offset : offset + n]
        self._factor[offset + n] = pivot
        self._values[n] = value
        self._whitened[n] = (value - self.prior_mean - row @ self._whitened[:n]) / pivot
        self._n = n + 1
        self._weights = None
        return max(variance, 0.0)

    def _append_with_gradient(self, point: NDArray[np.float64], value: float) -> tuple[float, NDArray[np.float64]]:
        n = self._n
        variance = self._append(point, value)
        address = self._address
        _C.gp_variance_gradient(
            _KERNELS[self.kernel],
            self.length_scale,
            address["points"],
            address["factor"],
            n,
            address["points"] + 24 * n,
            address["factor"] + 4 * n * (n + 1),
            address["work"],
            address["gradient"],
        )
        return variance, self._gradient.copy()

    def _mean_weights(self) -> NDArray[np.float64]:
        if self._weights is None:
            self._weights = self._whitened[: self._n].copy()
            _C.gp_backward(self._address["factor"], self._n, self._weights.ctypes.data)
        return self._weights

    # -- queries -------------------------------------------------------------------------------------------------

    def _kernel(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        out = np.empty((len(x), self._n))
        _C.gp_kernel(
            _KERNELS[self.kernel],
            self.length_scale,
            x.ctypes.data,
            len(x),
            self._address["points"],
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
            self._address["points"],
            self._address["factor"],
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
        extent = float(np.linalg.norm(both.max(0) - both.min(0)))
        if extent > self.length_scale and np.ptp(both, axis=0).max() > 0:
            # the box's diagonal bounds every distance; only where it fails are the distances worth looking at
            centre = self._points[0] if self._n else x[0]
            farthest = float(np.linalg.norm(both - centre, axis=1).max())
            if farthest > self.length_scale:
                raise ValueError(
                    f"length_scale (the thin plate's R) should be at least the distance of any two points, "
                    f"got {self.length_scale} for points {farthest:.6g} apart"
                )


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
