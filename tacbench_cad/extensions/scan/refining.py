"""The fine fit of a scan: a robust Gauss-Newton iteration on the distances of points from the block's exact faces.

The distances come from the formula itself, so nothing is lost by a sampled target, as it is in the usual point-to-plane
ICP: there is no nearest vertex, no normal of a triangle, and the spacing of a mesh does not limit the accuracy. The
amplitude and the phase of every wave of the formula are unknowns of the same fit, so a print that lost a part of its
fine waves does not pull the pose. Standard errors come from the residuals themselves (a sandwich estimator).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace

import numpy as np

from tacbench_cad.extensions.scan.estimates import Fit
from tacbench_cad.extensions.scan.faces import TABLE, TOP, WALL, Assigned, assign
from tacbench_cad.extensions.scan.height_model import Relief
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.spec import Block
from tacbench_cad.util.types import Bools, Floats, Ints

#: The residual, in standard deviations, from which a point has no weight.
TUKEY = 5.0
#: A direction is undetermined if its standard error moves points of the block by more than this, as a fraction of the
#: longer side.
_UNDETERMINED = 0.003
#: A wave is undetermined if the standard error of its relative amplitude is larger than this.
_UNDETERMINED_WAVE = 1.0
#: The number of cells along each side that show whether neighbouring residuals are correlated.
_CELLS = 20
_CHUNK = 50_000

SHIFTS = ("shift_x_mm", "shift_y_mm", "shift_z_mm")
ROTATIONS = ("rotation_x_deg", "rotation_y_deg", "rotation_z_deg")
SCALES = ("scale_x", "scale_y", "scale_z")
SKEWS = {"skew_xy": (0, 1), "skew_xz": (0, 2), "skew_yz": (1, 2)}


@dataclass(frozen=True, eq=False)
class State:
    """The unknowns of a fit and the noise.

    Args:
        pose: The pose.
        relief: The formula with the printed changes of its waves.
        base_mm: What the print is thicker than the block, in mm.
        wall_offset_mm: How far the walls of the print lie outside of the block as stretched.
        depth_mm: The standard deviation of the noise along the depth.
        lateral_mm: The standard deviation of the noise along x and y.
        faces: The faces that the scan shows. Points near other faces do not count.
    """

    pose: Pose
    relief: Relief
    base_mm: float = 0.0
    wall_offset_mm: float = 0.0
    depth_mm: float = 0.02
    lateral_mm: float = 0.02
    faces: frozenset[int] = frozenset((TOP,))

    @property
    def wall_offsets_mm(self) -> tuple[float, float]:
        """The offset of the walls along x and along y in the frame of the block, where the stretch is undone."""
        x, y, _ = np.diag(self.pose.stretch)
        return self.wall_offset_mm / float(x), self.wall_offset_mm / float(y)

    def assigned(self, points: Floats, block: Block, limit_mm: float) -> tuple[Floats, Assigned]:
        """Return points of the scan in the frame of the block, shape (n, 3), and the face to which each belongs.

        Near an edge, the noise may move a point to another face.
        """
        nominal = self.pose.to_block(points)
        edge_mm = TUKEY * self.depth_mm
        return nominal, assign(nominal, block, self.relief, limit_mm, edge_mm, self.wall_offsets_mm)


@dataclass(frozen=True)
class Unknowns:
    """Which parameters a fit has.

    Args:
        names: The parameters of the pose, the print and the faces, in order.
        waves: Whether the amplitude and the phase of every wave are unknown as well.
        scale_reference: The index of the wave whose amplitude gives the scale along z; None without that scale.
        shift_references: The indices of the waves whose phases give the shift.
    """

    names: tuple[str, ...]
    waves: bool = False
    scale_reference: int | None = None
    shift_references: tuple[int, ...] = ()


@dataclass(eq=False)
class Normal:
    """The normal equations of one step, and the sums for standard errors."""

    matrix: Floats
    right: Floats
    scores: Floats
    weight_sum: float = 0.0
    slope_sum: float = 0.0
    count: int = 0
    cell_sums: Floats = field(default_factory=lambda: np.zeros(_CELLS * _CELLS))
    square_sum: float = 0.0


def unknowns(fit: Fit, relief: Relief, faces: Collection[int], waves: bool) -> Unknowns:
    """Return the parameters of a fit, from the faces that the scan shows."""
    names = [*ROTATIONS, *SHIFTS]
    if fit != "pose":
        names += SCALES
    if fit == "square":
        names += SKEWS
    if TABLE in faces and TOP in faces:
        names.append("base_mm")
    if any(face >= WALL for face in faces) and TOP in faces:
        names.append("wall_offset_mm")
    if not (waves and relief.fitted):
        return Unknowns(tuple(names))
    table = relief.surface.table  # type: ignore[attr-defined]
    order = sorted(relief.fitted, key=lambda i: -abs(table[i, 0]))
    first = order[0]
    references = [first]
    for i in order[1:]:
        cross = table[first, 1] * table[i, 2] - table[first, 2] * table[i, 1]
        if abs(cross) > 0.1 * np.hypot(*table[first, 1:3]) * np.hypot(*table[i, 1:3]):
            references.append(i)
            break
    return Unknowns(tuple(names), True, first if fit != "pose" else None, tuple(references))


def centre_of(block: Block) -> Floats:
    """Return the centre of a block, about which small rotations turn."""
    return np.array([block.size_mm[0] / 2.0, block.size_mm[1] / 2.0, block.height_mm / 2.0])


def lengths(names: tuple[str, ...], block: Block) -> Floats:
    """Return how far a unit of each parameter moves points of the block at most, in mm."""
    half = max(block.size_mm) / 2.0
    result = []
    for name in names:
        if name.startswith("rotation"):
            result.append(math.radians(half))
        elif name == "scale_z":
            result.append(block.relief_mm / 2.0)
        else:
            result.append(half if name.startswith(("scale", "skew")) else 1.0)
    return np.array(result)


def jacobian(nominal: Floats, assigned: Assigned, state: State, block: Block, names: tuple[str, ...]) -> Floats:
    """Return the derivatives of the errors by the parameters, shape (n, parameters).

    They belong to the point of the face below or beside each point, because derivatives that contain the noise of the
    point itself would be correlated with its error, which shifts the estimates.
    """
    inverse = np.linalg.inv(state.pose.stretch)
    lift = assigned.normal.copy()
    lift[assigned.face == TOP, :2] = 0.0
    nominal = nominal - assigned.error_mm[:, None] * lift
    printed = nominal @ state.pose.stretch.T
    by_print: Floats = assigned.normal @ inverse
    columns: dict[str, Floats] = {}
    turned: Floats = np.cross(printed - centre_of(block), by_print) * (math.pi / 180.0)
    for axis in range(3):
        columns[ROTATIONS[axis]], columns[SHIFTS[axis]] = turned[:, axis], by_print[:, axis]
        columns[SCALES[axis]] = -by_print[:, axis] * nominal[:, axis]
    for name, (row, column) in SKEWS.items():
        columns[name] = -by_print[:, row] * nominal[:, column]
    columns["base_mm"] = np.where(assigned.face == TOP, -1.0, 0.0)
    columns["wall_offset_mm"] = np.where(assigned.face >= WALL, -1.0, 0.0)
    return np.column_stack([columns[name] for name in names])


def errors(assigned: Assigned, state: State) -> Floats:
    """Return the errors of points with the base of the print subtracted."""
    return np.asarray(assigned.error_mm - state.base_mm * (assigned.face == TOP))


def variance(assigned: Assigned, state: State) -> Floats:
    """Return the expected variance of each error: the slope adds the noise along x and y."""
    return np.asarray(state.depth_mm**2 + assigned.scatter * state.lateral_mm**2)


def chunks(count: int) -> Iterator[slice]:
    """Return slices that cover ``count`` points."""
    for start in range(0, count, _CHUNK):
        yield slice(start, min(start + _CHUNK, count))


def normal_equations(
    points: Floats, block: Block, state: State, unknown: Unknowns, limit_mm: float, *, scores: bool = False
) -> Normal:
    """Sum the normal equations over points, with Tukey's weights."""
    free = free_waves(state.relief, unknown)
    size = len(unknown.names) + len(free)
    total = Normal(np.zeros((size, size)), np.zeros(size), np.zeros((size, size)))
    for part in chunks(len(points)):
        nominal, assigned = state.assigned(points[part], block, limit_mm)
        error, expected = errors(assigned, state), variance(assigned, state)
        usable = assigned.clear & np.isin(assigned.face, list(state.faces))
        usable &= error**2 < TUKEY**2 * expected
        if not usable.any():
            continue
        keep = Assigned(*(values[usable] for values in vars(assigned).values()))
        error, expected = error[usable], expected[usable]
        design = jacobian(nominal[usable], keep, state, block, unknown.names)
        if len(free):
            waves = state.relief.columns(nominal[usable, 0], nominal[usable, 1])[:, free]
            design = np.concatenate([design, -waves * (keep.face == TOP)[:, None]], axis=1)
        u2 = error**2 / (TUKEY**2 * expected)
        weight = (1.0 - u2) ** 2 / expected
        weighted = design * weight[:, None]
        total.matrix += weighted.T @ design
        total.right -= weighted.T @ error
        total.weight_sum += float(np.sum((1.0 - u2) ** 2))
        total.slope_sum += float(np.sum((1.0 - u2) * (1.0 - 5.0 * u2)))
        total.count += len(error)
        if scores:
            weighted *= error[:, None]
            total.scores += weighted.T @ weighted
            top = keep.face == TOP
            score = (weight * error)[top]
            cell = np.clip((nominal[usable][top, :2] / block.size_mm * _CELLS).astype(int), 0, _CELLS - 1)
            total.cell_sums += np.bincount(cell[:, 0] * _CELLS + cell[:, 1], score, _CELLS * _CELLS)
            total.square_sum += float(score @ score)
    return total


def free_waves(relief: Relief, unknown: Unknowns) -> Ints:
    """Return the columns of :meth:`~tacbench_cad.extensions.scan.height_model.Relief.columns` that are unknown."""
    if not unknown.waves:
        return np.zeros(0, dtype=np.int64)
    count = len(relief.fitted)
    amplitude = [j for j, i in enumerate(relief.fitted) if i != unknown.scale_reference]
    phase = [count + j for j, i in enumerate(relief.fitted) if i not in unknown.shift_references]
    return np.array(amplitude + phase, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Solved:
    """The step of a fit, and what the scan determines.

    Args:
        step: The change of each parameter.
        gain: The matrix that maps the right side to the step, shape (p, p). Its null space is undetermined.
        determined: Whether each parameter is determined.
    """

    step: Floats
    gain: Floats
    determined: Bools


def solve(normal: Normal, unknown: Unknowns, block: Block) -> Solved:
    """Solve the normal equations, with no change along undetermined directions.

    The waves are eliminated first. The rest is scaled to lengths in mm, and its eigenvalues show which combinations of
    the parameters the scan determines.
    """
    primary = len(unknown.names)
    unit = 1.0 / lengths(unknown.names, block)
    h_pp = normal.matrix[:primary, :primary] * unit[:, None] * unit
    h_pn = normal.matrix[:primary, primary:] * unit[:, None]
    h_nn = normal.matrix[primary:, primary:]
    size = len(h_nn)
    values, vectors = np.linalg.eigh(h_nn) if size else (np.zeros(0), np.zeros((0, 0)))
    good = values > _UNDETERMINED_WAVE**-2
    inner = (vectors[:, good] / values[good]) @ vectors[:, good].T
    schur = h_pp - h_pn @ inner @ h_pn.T
    limit = _UNDETERMINED * max(block.size_mm)
    own, directions = np.linalg.eigh(schur)
    known = own > limit**-2
    outer = (directions[:, known] / own[known]) @ directions[:, known].T
    gain = np.zeros((primary + size, primary + size))
    cross = -outer @ h_pn @ inner
    gain[:primary, :primary], gain[:primary, primary:], gain[primary:, :primary] = outer, cross, cross.T
    gain[primary:, primary:] = inner + inner @ h_pn.T @ outer @ h_pn @ inner
    scale = np.concatenate([unit, np.ones(size)])
    gain = gain * scale[:, None] * scale
    missing = np.sum(directions[:, ~known] ** 2, axis=1) < 1e-4
    missing_waves = np.sum(vectors[:, ~good] ** 2, axis=1) < 1e-2
    return Solved(gain @ normal.right, gain, np.concatenate([missing, missing_waves]))


def moved(state: State, step: Floats, unknown: Unknowns, block: Block) -> State:
    """Return the state after a step."""
    from scipy.spatial.transform import Rotation

    change = dict(zip(unknown.names, step[: len(unknown.names)], strict=True))
    turn = Rotation.from_rotvec([change[name] for name in ROTATIONS], degrees=True).as_matrix()
    centre = centre_of(block)
    shift = turn @ (state.pose.shift_mm - centre) + centre + [change[name] for name in SHIFTS]
    stretch = state.pose.stretch.copy()
    for axis, name in enumerate(SCALES):
        stretch[axis, axis] += change.get(name, 0.0)
    for name, place in SKEWS.items():
        stretch[place] += change.get(name, 0.0)
    rotation = turn @ state.pose.rotation
    left, _, right = np.linalg.svd(rotation)  # rounding errors add up over steps
    pose = Pose(rotation=left @ right, shift_mm=shift, stretch=stretch)
    relief, changes = state.relief, state.relief.changes.copy()
    fitted, count = list(state.relief.fitted), len(state.relief.fitted)
    for column, value in zip(free_waves(state.relief, unknown), step[len(unknown.names) :], strict=True):
        changes[fitted[column % count], column // count] += value
    if unknown.waves:
        relief = relief.changed(changes, relief.blur_mm)
    return replace(
        state,
        pose=pose,
        relief=relief,
        base_mm=state.base_mm + change.get("base_mm", 0.0),
        wall_offset_mm=state.wall_offset_mm + change.get("wall_offset_mm", 0.0),
    )


def trimmed_deviation(values: Floats) -> float:
    """Return the standard deviation of normal values without outliers: from those within 2.5 deviations."""
    if len(values) < 3:
        return math.nan
    sigma = 1.4826 * float(np.median(np.abs(values)))
    for _ in range(20):
        inner = values[np.abs(values) < 2.5 * sigma]
        if not len(inner):
            break
        before, sigma = sigma, math.sqrt(float(inner @ inner) / len(inner) / 0.911253)
        if abs(sigma - before) < 1e-4 * sigma:
            break
    return sigma


def with_noise(points: Floats, block: Block, state: State, limit_mm: float, *, blur: bool) -> State:
    """Return the state with the noise that its residuals show, along the depth and along x and y.

    The noise along x and y is seen where the top is steep: the variance of the error grows with the squared slope.
    """
    _, assigned = state.assigned(points, block, limit_mm)
    error = errors(assigned, state)
    top = (assigned.face == TOP) & assigned.clear
    if np.count_nonzero(top) < 100:
        sigma = trimmed_deviation(error[assigned.clear & np.isfinite(error)])
        return replace(state, depth_mm=max(sigma, 1e-6), lateral_mm=max(sigma, 1e-6))
    depth, lateral = _noise(assigned.scatter[top], error[top])
    most = limit_mm / TUKEY
    state = replace(state, depth_mm=min(math.sqrt(depth), most), lateral_mm=min(math.sqrt(lateral), most))
    if blur:
        # What a narrow flank leaves over looks like noise along x and y, but no more of it than along the depth.
        blur_mm = min(state.lateral_mm, state.depth_mm)
        state = replace(state, relief=state.relief.changed(state.relief.changes, blur_mm))
    return state


def _noise(scatter: Floats, error: Floats) -> tuple[float, float]:
    """Return the variances of the noise along the depth and along x and y.

    Errors beyond three standard deviations are left out, which takes 2.67 % of the variance of normal errors.
    """
    depth = lateral = trimmed_deviation(error / np.sqrt(1.0 + scatter)) ** 2
    smallest = max(1e-4 * depth, 1e-14)
    for _ in range(40):
        expected = depth + lateral * scatter
        inner = error**2 < 9.0 * expected
        weight, level, square = expected[inner] ** -2.0, scatter[inner], error[inner] ** 2 / 0.97334
        total = np.array([[weight.sum(), weight @ level], [weight @ level, weight @ level**2]])
        right = np.array([weight @ square, weight @ (level * square)])
        before = depth, lateral
        if np.linalg.det(total) <= 1e-9 * total[0, 0] * total[1, 1]:
            depth, lateral = float(right[0] / total[0, 0]), 0.0
        else:
            depth, lateral = (float(value) for value in np.linalg.solve(total, right))
        if lateral <= 0.0:
            depth, lateral = float(right[0] / total[0, 0]), 0.0
        elif depth < smallest:
            depth, lateral = smallest, float(right[1] / total[1, 1])
        if abs(depth - before[0]) + abs(lateral - before[1]) < 1e-4 * (depth + lateral):
            break
    return max(depth, smallest), max(lateral, 0.0)


def iterate(points: Floats, block: Block, state: State, unknown: Unknowns, limit_mm: float, steps: int) -> State:
    """Repeat Gauss-Newton steps until the points move by less than a nanometre.

    On steep flanks, steps can go too far and come back for ever. A step that reverses the step before is halved.
    """
    unit = lengths(unknown.names, block)
    before = np.zeros(len(unit))
    for _ in range(steps):
        normal = normal_equations(points, block, state, unknown, limit_mm)
        if normal.count < 10:
            return state
        step = solve(normal, unknown, block).step
        move = step[: len(unit)] * unit
        factor = 0.5 if move @ before < -0.25 * (before @ before) else 1.0
        factor = min(factor, 0.2 * block.size_mm[0] / max(np.abs(move).max(), 1e-12))
        state, before = moved(state, factor * step, unknown, block), factor * move
        if np.abs(move).max() < 1e-6:
            break
    return state
