"""DBSCAN (Ester et al. 1996) with exact labels, in memory that grows with the number of points alone.

scikit-learn's keeps the list of all neighbours, which for one dense blob is the square of the number of points. Here
few points are compared each with each. Of many, a grid tells most: two points of a cell of side eps/sqrt(3) are
neighbours, so its points are counted and joined without a distance; distances are taken only where cells leave it open.

The labels are scikit-learn's, number for number: clusters are counted in the order of their first core point, and a
border point belongs to the first of the clusters that reach it. Only of two points whose distance is eps to the last
digit either may be right.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Final

import numpy as np
from numpy.typing import NDArray

from learner.model.pose import Array
from learner.model.poses import Mask, Rows

FEW: Final = 1000
"""So many points are compared each with each."""
AT_ONCE: Final = 2_000_000
"""So many distances are held at once."""
SMALL: Final = 256
"""Pairs of cells with at most so many pairs of points are compared many at a time."""
FINER: Final = (math.sqrt(3), 5.0, 11.0)
"""Cells of eps over these sides are counted, one after the other, until every point is known to be core or not ..."""
LOOKUP: Final = 40.0
"""... or distances are cheaper: one look at a row of cells takes as long as so many of them."""
SAFE: Final = 1e-9
"""By so much, relatively, cells must be nearer or further than eps to tell something: rounding moves points less."""
NOISE: Final = -1


def dbscan(points: Array, eps_m: float, min_samples: int) -> NDArray[np.intp]:
    """A label (n,) for each of `points` (n, 3): clusters from 0, -1 for noise.

    A point is core if at least `min_samples` points, itself among them, lie within `eps_m` [m] of it.
    """
    if len(points) < min_samples:
        return np.full(len(points), NOISE, dtype=np.intp)
    if _together(points, eps_m):
        return np.zeros(len(points), dtype=np.intp)
    if not _crowded(points, eps_m, min_samples):
        return np.full(len(points), NOISE, dtype=np.intp)
    if len(points) <= FEW:
        return _of_few(points, eps_m, min_samples)
    core = _core(points, eps_m, min_samples)
    labels = np.full(len(points), NOISE, dtype=np.intp)
    if core.any():
        numbers = np.flatnonzero(core)
        labels[numbers] = _components(points[numbers], eps_m)
        others = np.flatnonzero(~core)
        labels[others] = _borders(points[others], points[numbers], labels[numbers], eps_m)
    return labels


def _together(points: Array, eps_m: float) -> bool:
    """Whether all points surely are neighbours of each other: no further from their median than half of eps."""
    return bool((_squares(points, np.median(points, axis=0)[None]) <= (eps_m * (1 - SAFE) / 2) ** 2).all())


def _crowded(points: Array, eps_m: float, min_samples: int) -> bool:
    """Whether some point may be core: enough others are near enough to it along each axis."""
    reach, possible = eps_m * (1 + SAFE), np.ones(len(points), dtype=np.bool_)
    for along in points.T:
        ordered = np.sort(along)
        first, last = np.searchsorted(ordered, along - reach), np.searchsorted(ordered, along + reach, side="right")
        possible &= last - first >= min_samples
    return bool(possible.any())


def _of_few(points: Array, eps_m: float, min_samples: int) -> Rows:
    near = _neighbours(points, eps_m)
    core = near.sum(axis=1) >= min_samples
    labels = np.full(len(points), NOISE, dtype=np.intp)
    label = 0
    for first in np.flatnonzero(core):
        if labels[first] == NOISE:
            inside = _reached(int(first), near, core)
            labels[inside & (labels == NOISE)] = label
            label += 1
    return labels


def _reached(first: int, near: Mask, core: Mask) -> Mask:
    """What is reached from a core point over core points (n,)."""
    inside = near[first].copy()
    spread = np.zeros(len(core), dtype=np.bool_)
    spread[first] = True
    while (ahead := inside & core & ~spread).any():
        inside |= np.asarray(near[ahead].any(axis=0))
        spread |= ahead
    return np.asarray(inside)


def _neighbours(points: Array, eps_m: float) -> Mask:
    """Which of few points (n, n) are neighbours. One product of matrices tells, but for those that rounding decides."""
    centred = points - points.mean(axis=0)
    lengths = np.einsum("ij,ij->i", centred, centred)
    squares = centred @ (-2 * centred.T)
    squares += lengths
    squares += lengths[:, None]
    slack = SAFE * (eps_m**2 + lengths.max())
    near, possible = squares <= eps_m**2 - slack, squares <= eps_m**2 + slack
    a, b = np.nonzero(near ^ possible)
    x, y, z = (points[a] - points[b]).T
    near[a, b] = x * x + y * y + z * z <= eps_m**2
    return np.asarray(near)


def _squares(points: Array, others: Array) -> Array:
    """The squared distances (n, m) of points (n, 3) to others (m, 3), summed in the order of the axes."""
    x, y, z = (points[:, None, axis] - others[None, :, axis] for axis in range(3))
    return np.asarray(x * x + y * y + z * z)


@dataclass(frozen=True, eq=False)
class _Grid:
    """Points (n, 3) in cubes of `side_m`; the cells that hold any are counted from 0 in the order of their keys."""

    points: Array
    side_m: float

    @cached_property
    def _places(self) -> tuple[Rows, Rows]:
        """The whole coordinates (n, 3) of the cell of each point, and the size (3,) of a box around all.

        Wide gaps are narrowed: nothing reaches over them.
        """
        places = np.floor((self.points - self.points.min(axis=0)) / self.side_m).astype(np.intp)
        reach = self.reach(2.0 * self.side_m * max(FINER))
        for axis in range(3):
            values, where = np.unique(places[:, axis], return_inverse=True)
            steps = np.minimum(np.diff(values, prepend=values[0]), 2 * reach)
            places[:, axis] = np.cumsum(steps)[where] + reach
        size = places.max(axis=0) + reach + 1
        if math.prod(size.tolist()) >= 2**63:
            raise OverflowError(f"{len(self.points)} points lie in too many cells of {self.side_m:g} m")
        return places, size

    @cached_property
    def _strides(self) -> Rows:
        _, size = self._places
        return np.array([size[1] * size[2], size[2], 1], dtype=np.intp)

    @cached_property
    def _sorted(self) -> tuple[Rows, Rows, Rows, Rows]:
        places, _ = self._places
        keys, of, counts = np.unique(places @ self._strides, return_inverse=True, return_counts=True)
        return keys, of.reshape(-1), counts, np.argsort(of.reshape(-1), kind="stable")

    @property
    def of(self) -> Rows:
        """The cell (n,) of each point."""
        return self._sorted[1]

    @property
    def order(self) -> Rows:
        """The points (n,), cell by cell."""
        return self._sorted[3]

    @property
    def counts(self) -> Rows:
        """How many points each cell (c,) holds."""
        return self._sorted[2]

    @cached_property
    def starts(self) -> Rows:
        """Where the points of each cell begin in `order`, and where they end (c + 1,)."""
        return np.concatenate([[0], np.cumsum(self.counts)])

    def inside(self, cell: int) -> Rows:
        """The points of a cell."""
        return self.order[self.starts[cell] : self.starts[cell + 1]]

    @cached_property
    def boxes(self) -> tuple[Array, Array]:
        """The least and the greatest coordinates [m] of the points of each cell (c, 3)."""
        ordered = self.points[self.order]
        return np.minimum.reduceat(ordered, self.starts[:-1]), np.maximum.reduceat(ordered, self.starts[:-1])

    def reach(self, eps_m: float) -> int:
        """How many cells away along an axis a neighbour may be."""
        return math.ceil(eps_m / self.side_m * (1 + SAFE))

    def counted(self, cells: Rows, eps_m: float) -> tuple[Rows, Rows]:
        """How many neighbours each point of some cells has at least, and at most (k,)."""
        least, most = self.counts[cells], np.zeros(len(cells), dtype=np.intp)
        for x, y in product(self._span(eps_m), repeat=2):
            far = self._furthest(math.hypot(abs(x) + 1, abs(y) + 1), eps_m * (1 - SAFE)) - 1
            near = self._furthest(math.hypot(max(abs(x) - 1, 0), max(abs(y) - 1, 0)), eps_m * (1 + SAFE)) + 1
            most += self._in_row(cells, (x, y), near)
            least += self._in_row(cells, (x, y), far) - ((x, y) == (0, 0) and far >= 0) * self.counts[cells]
        return least, most

    def _span(self, eps_m: float) -> range:
        return range(-self.reach(eps_m), self.reach(eps_m) + 1)

    def _furthest(self, sides: float, eps_m: float) -> int:
        """How many sides upwards lie within `eps_m` of what is so many sides beside; -1 where that alone is further."""
        left = (eps_m / self.side_m) ** 2 - sides**2
        return -1 if left < 0 else math.floor(math.sqrt(left))

    def _in_row(self, cells: Rows, beside: tuple[int, int], reach: int) -> Rows:
        """How many points (k,) lie in the cells beside each of some cells, up to so many up and down; -1 is none."""
        if reach < 0:
            return np.zeros(len(cells), dtype=np.intp)
        keys = self._sorted[0]
        middle = keys[cells] + int(np.dot(self._strides, (*beside, 0)))
        begin, end = np.searchsorted(keys, middle - reach), np.searchsorted(keys, middle + reach, side="right")
        return self.starts[end] - self.starts[begin]

    def pairs(self, eps_m: float) -> Iterator[Rows]:
        """The pairs (k, 2) of cells that may hold neighbours, each once."""
        cells, span = np.arange(len(self.counts)), self._span(eps_m)
        for offset in product(span, repeat=3):
            gap = math.hypot(*(max(abs(d) - 1, 0) for d in offset)) * self.side_m
            if offset > (0, 0, 0) and gap <= eps_m * (1 + SAFE):
                others = self.at(offset, cells)
                yield np.stack([cells[others >= 0], others[others >= 0]], axis=1)

    def at(self, offset: tuple[int, ...], cells: Rows) -> Rows:
        """The cell (k,) that lies at an offset from each of some cells; -1 where none does."""
        keys = self._sorted[0]
        wanted = keys[cells] + int(np.dot(self._strides, offset))
        found = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where(keys[found] == wanted, found, -1)


def _core(points: Array, eps_m: float, min_samples: int) -> Mask:
    """Which points (n,) are core: told by counting the cells around, and by distances where that leaves it open."""
    core = _near_the_middle(points, eps_m) >= min_samples
    left = np.flatnonzero(~core)
    for parts in FINER if len(left) else ():
        grid = _Grid(points, eps_m * (1 - SAFE) / parts)
        cells, of = np.unique(grid.of[left], return_inverse=True)
        looks = 4 * len(cells) * (2 * grid.reach(eps_m) + 1) ** 2
        if parts != FINER[0] and LOOKUP * looks > len(left) * len(points):
            break
        least, most = grid.counted(cells, eps_m)
        core[left] = (least >= min_samples)[of]
        left = left[((least < min_samples) & (most >= min_samples))[of]]
    core[left] = _enough(points[left], points, eps_m, min_samples)
    return core


def _near_the_middle(points: Array, eps_m: float) -> Rows:
    """How many neighbours each point (n,) has at least: those that are near enough to the median of all."""
    away = np.sqrt(_squares(points, np.median(points, axis=0)[None])[:, 0])
    return np.searchsorted(np.sort(away), eps_m * (1 - SAFE) - away, side="right")


def _enough(points: Array, others: Array, eps_m: float, least: int) -> Mask:
    """Which of some points (k, 3) have at least so many of the others (n, 3) within `eps_m`."""
    if len(points) * len(others) <= 4 * AT_ONCE:
        return _counts(points, others, eps_m) >= least
    from scipy.spatial import cKDTree

    tree = cKDTree(others)
    # A little nearer and a little further than eps, so that the tree's rounding decides nothing.
    enough = np.asarray(tree.query_ball_point(points, eps_m * (1 - SAFE), return_length=True) >= least)
    left = np.flatnonzero(~enough)
    left = left[tree.query_ball_point(points[left], eps_m * (1 + SAFE), return_length=True) >= least]
    enough[left] = _counts(points[left], others, eps_m) >= least
    return enough


def _counts(points: Array, others: Array, eps_m: float) -> Rows:
    """How many of the others (n, 3) lie within `eps_m` of each of some points (k, 3)."""
    counts = np.zeros(len(points), dtype=np.intp)
    for part in _parts(len(points), len(others)):
        counts[part] = (_squares(points[part], others) <= eps_m**2).sum(axis=1)
    return counts


def _parts(count: int, others: int) -> Iterator[slice]:
    """Slices of so many points that their distances to the others can be held at once."""
    size = max(1, AT_ONCE // max(others, 1))
    return (slice(begin, begin + size) for begin in range(0, count, size))


def _components(points: Array, eps_m: float) -> Rows:
    """The cluster (n,) of each core point, counted in the order of the first point of each."""
    grid = _Grid(points, eps_m * (1 - SAFE) / FINER[0])
    low, high = grid.boxes
    joined = _Joined(len(grid.counts))
    unsure = []
    for pairs in grid.pairs(eps_m):
        a, b = pairs.T
        most = np.linalg.norm(np.maximum(high[a] - low[b], high[b] - low[a]), axis=1)
        least = np.linalg.norm(np.maximum(np.maximum(low[a] - high[b], low[b] - high[a]), 0.0), axis=1)
        near = most <= eps_m * (1 - SAFE)
        joined.join_all(pairs[near])
        unsure.append(pairs[~near & (least <= eps_m * (1 + SAFE))])
    _join_what_touches(np.concatenate(unsure), joined, grid, eps_m)
    return _in_order(joined.parts()[grid.of])


def _join_what_touches(pairs: Rows, joined: _Joined, grid: _Grid, eps_m: float) -> None:
    """Join the pairs of cells (k, 2) of which some points are neighbours; those of few points all together."""
    parts = joined.parts()
    pairs = pairs[parts[pairs[:, 0]] != parts[pairs[:, 1]]]
    products = grid.counts[pairs[:, 0]] * grid.counts[pairs[:, 1]]
    small = pairs[products <= SMALL]
    for part in _parts(len(small), SMALL):
        joined.join_all(small[part][_small_touch(small[part], grid, eps_m)])
    for a, b in pairs[products > SMALL].tolist():
        if joined.root(a) != joined.root(b):
            few, many = sorted((grid.points[grid.inside(a)], grid.points[grid.inside(b)]), key=len)
            if any((_squares(few[part], many) <= eps_m**2).any() for part in _parts(len(few), len(many))):
                joined.join_all(np.array([[a, b]]))


def _small_touch(pairs: Rows, grid: _Grid, eps_m: float) -> Mask:
    """In which pairs of cells (k, 2) some point is a neighbour of one of the other cell."""
    first, second = grid.counts[pairs].T
    products = first * second
    pair = np.repeat(np.arange(len(pairs)), products)
    place = np.arange(len(pair)) - np.repeat(np.cumsum(products) - products, products)
    a = grid.points[grid.order[grid.starts[pairs[pair, 0]] + place // second[pair]]]
    b = grid.points[grid.order[grid.starts[pairs[pair, 1]] + place % second[pair]]]
    x, y, z = (a - b).T
    return np.bincount(pair, x * x + y * y + z * z <= eps_m**2, minlength=len(pairs)) > 0


class _Joined:
    """Which of some cells hang together."""

    def __init__(self, count: int) -> None:
        self.parent = list(range(count))

    def root(self, cell: int) -> int:
        """What stands for all that hang together with a cell."""
        parent = self.parent
        while parent[cell] != cell:
            parent[cell] = cell = parent[parent[cell]]
        return cell

    def join_all(self, pairs: Rows) -> None:
        """Let each of some pairs (k, 2) hang together."""
        for a, b in pairs.tolist():
            self.parent[self.root(a)] = self.root(b)

    def parts(self) -> Rows:
        """What stands for the part of each cell (c,)."""
        return np.array([self.root(cell) for cell in range(len(self.parent))], dtype=np.intp)


def _in_order(parts: Rows) -> Rows:
    """The same partition (n,), its parts counted in the order of their first members."""
    _, first, of = np.unique(parts, return_index=True, return_inverse=True)
    rank = np.empty(len(first), dtype=np.intp)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[of.reshape(-1)]


def _borders(points: Array, core: Array, labels: Rows, eps_m: float) -> Rows:
    """The first cluster (n,) that has a core point (m, 3) within `eps_m` of each point; NOISE for none."""
    from scipy.spatial import cKDTree

    found = np.full(len(points), NOISE, dtype=np.intp)
    for label in range(int(labels.max()) + 1):
        inside = core[labels == label]
        near = (points >= inside.min(axis=0) - eps_m) & (points <= inside.max(axis=0) + eps_m)
        open_ = np.flatnonzero((found == NOISE) & near.all(axis=1))
        if len(open_):
            away, _ = cKDTree(inside).query(points[open_], distance_upper_bound=eps_m * (1 + SAFE))
            reached = np.asarray(away <= eps_m * (1 - SAFE))
            for row in np.flatnonzero(np.isfinite(away) & ~reached):
                reached[row] = _counts(points[open_[row]][None], inside, eps_m)[0] > 0
            found[open_[reached]] = label
    return found
