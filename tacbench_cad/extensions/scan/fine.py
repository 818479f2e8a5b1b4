"""The steps of a fine fit: from a rough pose to estimates of parameters and printed waves with intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from tacbench_cad.extensions.scan.estimates import HALF_WIDTH, Estimate, Fit, WaveEstimate, wave_direction_deg
from tacbench_cad.extensions.scan.faces import TABLE, TOP, WALL, walls_of
from tacbench_cad.extensions.scan.height_model import Relief
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.extensions.scan.refining import (
    SCALES,
    SHIFTS,
    TUKEY,
    Normal,
    Solved,
    State,
    Unknowns,
    errors,
    free_waves,
    iterate,
    moved,
    normal_equations,
    solve,
    unknowns,
    with_noise,
)
from tacbench_cad.spec import Block, WaveSum
from tacbench_cad.util.types import Floats

#: The shortest wave that a height map shows, in pixels. Two pixels are the least (Nyquist).
PIXELS_IN_WAVE = 2.5
#: The standard error of the place of a flank that is narrower than the pixels of a height map, in pixels, if its rows
#: run along the sides of the block: all rows then leave the same place open. If they cross the sides by some pixels,
#: they see the flank at different places.
_FLANK_ERROR, _CROSSED = 0.6, 2.0
#: A texture has such flanks if waves that the pixels do not show have at least this fraction of its root mean square.
_NARROW = 0.02
#: The number of points of the first steps, and of the steps that compare poses.
FIRST_POINTS = 4_000
COMPARED_POINTS = 20_000
#: The distance from the block from which points count as a sign of the table, as a fraction of the longer side.
_TABLE_FROM = 0.03
#: The smallest reach of the first steps, in mm. The walls of a print may lie this far outside of the block.
_MIN_REACH = 0.2
#: The largest number of products in the sums of the last step, which limits the number of points.
_MAX_PRODUCTS = 5e9
_MAX_POINTS = 2_000_000
#: The length of a vector of two normal components, in standard deviations, that noise alone exceeds in 5 % of cases.
_LENGTH_OF_NOISE = 2.448
#: The largest number of points of the steps before the last.
_MAX_REPEATED = 200_000


def thinned(points: Floats, count: int) -> Floats:
    """Return at most ``count`` of the points, drawn evenly. The same points give the same selection."""
    if len(points) <= count:
        return points
    return points[np.sort(np.random.default_rng(0).choice(len(points), count, replace=False))]


@dataclass(frozen=True, eq=False)
class Rough:
    """The first steps of a fit, in which points within a shrinking distance of a sharper and sharper relief count."""

    block: Block
    limits: tuple[float, ...]
    reliefs: tuple[Relief, ...]

    @classmethod
    def of(cls, block: Block) -> Rough:
        """Return the steps for a block. Many poses can share them."""
        plain = Relief.of(block)
        limits = tuple(max(factor * plain.rms_mm, _MIN_REACH) for factor in (1.0, 0.6, 0.35))
        return cls(block, limits, tuple(plain.changed(plain.changes, 0.5 * limit) for limit in limits))

    def __call__(self, points: Floats, pose: Pose) -> State:
        """Return the state after these steps."""
        faces = frozenset((TABLE, TOP, *(WALL + i for i in range(len(walls_of(self.block))))))
        free = unknowns("pose", self.reliefs[0], faces - {TABLE}, waves=False)
        # Within a large distance, flanks of the texture look like walls and would move all walls.
        held = Unknowns(tuple(name for name in free.names if name != "wall_offset_mm"))
        state = State(pose, self.reliefs[0], faces=faces)
        stages = ((held, 5), (held, 4), (free, 4))
        for limit, relief, (unknown, steps) in zip(self.limits, self.reliefs, stages, strict=True):
            state = replace(state, relief=relief, depth_mm=limit / TUKEY, lateral_mm=limit / TUKEY)
            state = iterate(points, self.block, state, unknown, limit, steps)
        return replace(state, wall_offset_mm=float(np.clip(state.wall_offset_mm, -_MIN_REACH, _MIN_REACH)))


def cost(points: Floats, block: Block, state: State, limit_mm: float) -> Floats:
    """Return the squared distance of each point from its face, at most the squared limit, in mm^2; shape (n,)."""
    _, assigned = state.assigned(points, block, limit_mm)
    distance = errors(assigned, state) / np.sqrt(1.0 + assigned.slope2)
    return np.asarray(np.minimum(np.nan_to_num(distance**2, nan=limit_mm**2), limit_mm**2))


def faces_seen(points: Floats, block: Block, state: State, limit_mm: float) -> frozenset[int]:
    """Return the faces to which at least 1 % of the points belong.

    The lower ends of walls and outliers beside them are no table, so points of the table count from some distance on.
    """
    nominal, assigned = state.assigned(points, block, limit_mm)
    middle = np.array(block.size_mm) / 2.0
    beside = np.max(np.abs(nominal[:, :2] - middle) - middle, axis=1) > _TABLE_FROM * max(block.size_mm)
    counted = assigned.clear & ((assigned.face != TABLE) | beside)
    kinds, counts = np.unique(assigned.face[counted], return_counts=True)
    return frozenset(int(kind) for kind, number in zip(kinds, counts, strict=True) if number >= 0.01 * len(points))


def simple(points: Floats, block: Block, state: State, fit: Fit, limit_mm: float) -> tuple[State, frozenset[int]]:
    """Return the state with the scale and the skew fitted but not the waves, and the faces that the scan shows."""
    noise = limit_mm / TUKEY
    state = replace(state, relief=Relief.of(block), base_mm=0.0, depth_mm=noise, lateral_mm=noise)
    faces = faces_seen(points, block, state, limit_mm)
    state = replace(state, faces=faces)
    return iterate(points, block, state, unknowns(fit, state.relief, faces, waves=False), limit_mm, 4), faces


def refined(
    points: Floats, block: Block, state: State, fit: Fit, limit_mm: float, shortest_mm: float
) -> tuple[State, Unknowns]:
    """Return the state with the scale, the skew and the waves fitted, and the parameters of the fit.

    Waves shorter than ``shortest_mm`` stay as they are in the formula.
    """
    state, faces = simple(points, block, state, fit, limit_mm)
    state = replace(state, relief=replace(state.relief, shortest_mm=shortest_mm))
    full = unknowns(fit, state.relief, faces, waves=True)
    for turn in range(10):
        before = state
        state = iterate(points, block, state, full, limit_mm, 3 if turn < 2 else 2)
        state = with_noise(points, block, state, limit_mm, blur=True)
        if settled(before, state):
            break
    return state, full


def settled(before: State, after: State) -> bool:
    """Return whether the noise of two states agrees within 2 % of the noise along the depth."""
    most = 0.02 * after.depth_mm
    return abs(after.depth_mm - before.depth_mm) < most and abs(after.lateral_mm - before.lateral_mm) < most


@dataclass(frozen=True, eq=False)
class Final:
    """The last step of a fit: the state, the solved equations, and standard errors of all unknowns."""

    state: State
    unknown: Unknowns
    solved: Solved
    standard_error: Floats
    correlation: float


def finish(points: Floats, block: Block, state: State, unknown: Unknowns, limit_mm: float, blur: bool) -> Final:
    """Return the last steps of a fit with as many points as time allows, and the standard errors."""
    columns = len(unknown.names) + 2 * len(state.relief.fitted)
    some = thinned(points, int(max(COMPARED_POINTS, min(_MAX_REPEATED, _MAX_PRODUCTS / 4.0 / columns**2))))
    for _ in range(4):
        before = state
        state = iterate(some, block, state, unknown, limit_mm, 2)
        state = with_noise(some, block, state, limit_mm, blur=blur)
        if settled(before, state):
            break
    # All points take one step from there, because their sums take most of the time.
    points = thinned(points, int(max(COMPARED_POINTS, min(_MAX_POINTS, _MAX_PRODUCTS / columns**2))))
    normal = normal_equations(points, block, state, unknown, limit_mm, scores=True)
    state = moved(state, solve(normal, unknown, block).step, unknown, block)
    solved = solve(normal, unknown, block)
    correlation = _correlation(normal)
    ratio = normal.weight_sum / max(normal.slope_sum, 1e-9)
    covariance = solved.gain @ normal.scores @ solved.gain
    # The residuals are smaller than the errors, because the unknowns follow the points.
    freedom = normal.count / max(1, normal.count - int(np.count_nonzero(solved.determined)))
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0) * correlation * freedom) * ratio
    return Final(state, unknown, solved, np.where(solved.determined, error, math.inf), math.sqrt(correlation))


def _correlation(normal: Normal) -> float:
    """Return the factor by which sums over cells vary more than independent residuals would; at least 1."""
    cells = np.count_nonzero(normal.cell_sums)
    if cells < 20 or normal.square_sum <= 0.0:
        return 1.0
    factor = float(normal.cell_sums @ normal.cell_sums) / normal.square_sum
    return factor if factor > 1.0 + 2.0 * math.sqrt(2.0 / cells) else 1.0


def estimates(final: Final, block: Block) -> tuple[Estimate, ...]:
    """Return the estimates of the parameters of the pose and the print."""
    state, names = final.state, final.unknown.names
    values = {f"scale_{axis}": float(state.pose.stretch[i, i]) for i, axis in enumerate("xyz")}
    values |= {"skew_xy": float(state.pose.stretch[0, 1]), "skew_xz": float(state.pose.stretch[0, 2])}
    values |= {"skew_yz": float(state.pose.stretch[1, 2]), "wall_offset_mm": state.wall_offset_mm}
    values |= {f"shift_{axis}_mm": float(state.pose.shift_mm[i]) for i, axis in enumerate("xyz")}
    values["base_mm"] = block.base_mm + state.base_mm
    open_places, result = _open_places(state, block), []
    for j, name in enumerate(names):
        value, error = values.get(name, 0.0), math.hypot(final.standard_error[j], open_places.get(name, 0.0))
        result.append(
            Estimate(name=name, value=value, standard_error=error, determined=bool(final.solved.determined[j]))
        )
    # The scan may not show the faces that the base and the offset of the walls need.
    for name, value in {"base_mm": block.base_mm, "wall_offset_mm": 0.0}.items():
        if name not in names:
            result.append(Estimate(name=name, value=value, standard_error=math.inf, determined=False))
    return tuple(result)


def _open_places(state: State, block: Block) -> dict[str, float]:
    """Return the standard errors that pixels leave open because flanks of the texture are narrower."""
    relief, result = state.relief, {}
    hidden, pixel_mm = list(set(relief.moving) - set(relief.fitted)), relief.shortest_mm / PIXELS_IN_WAVE
    if hidden and np.abs(state.pose.rotation[:2, 0]).min() * max(block.size_mm) < _CROSSED * pixel_mm:
        table = relief.surface.table[hidden]  # type: ignore[attr-defined]
        for axis, side in enumerate(block.size_mm):
            rms_mm = math.sqrt(0.5 * float(np.sum(table[table[:, 1 + axis] != 0.0, 0] ** 2)))
            if rms_mm > _NARROW * relief.rms_mm:
                result[SHIFTS[axis]] = _FLANK_ERROR * pixel_mm
                result[SCALES[axis]] = _FLANK_ERROR * pixel_mm / side
    return result


def wave_estimates(relief: Relief, unknown: Unknowns, standard_error: Floats) -> tuple[WaveEstimate, ...]:
    """Return the estimate of each wave that has an amplitude.

    Args:
        relief: The fitted relief.
        unknown: The parameters of the fit.
        standard_error: The standard errors of the free numbers of the waves, in the order of ``free_waves``.
    """
    if not isinstance(relief.surface, WaveSum) or not unknown.waves:
        return ()
    count = len(relief.fitted)
    known = np.zeros(2 * count)
    known[free_waves(relief, unknown)] = standard_error
    errors = {i: (float(known[j]), float(known[count + j])) for j, i in enumerate(relief.fitted)}
    result = []
    for i in relief.moving:
        wave = relief.surface.waves[i]
        spread, turn_spread = errors.get(i, (math.inf, math.inf))
        cosine, sine = 1.0 + relief.changes[i, 0], relief.changes[i, 1]
        phase = math.degrees(math.atan2(sine, cosine))
        ratio = _length(cosine, sine, spread) if turn_spread else cosine
        # The phase of a wave that is hardly there is not known at all.
        turn = math.degrees(turn_spread / ratio) if ratio > 0.0 else math.inf
        half = min(HALF_WIDTH * turn, 180.0)
        result.append(
            WaveEstimate(
                wave=wave,
                wavelength_mm=2.0 * math.pi / math.hypot(wave.f, wave.g),
                direction_deg=wave_direction_deg(wave),
                amplitude_ratio=ratio,
                ratio_low=max(0.0, ratio - HALF_WIDTH * spread),
                ratio_high=ratio + HALF_WIDTH * spread,
                standard_error=spread,
                phase_deg=phase,
                phase_low_deg=phase - half,
                phase_high_deg=phase + half,
                is_scale_reference=i == unknown.scale_reference,
                is_shift_reference=i in unknown.shift_references,
                determined=math.isfinite(spread + turn_spread),
            )
        )
    return tuple(result)


def _length(cosine: float, sine: float, spread: float) -> float:
    """Return the length of a vector from its measured components, without the length that the noise alone gives.

    A wave that cannot be told from noise at 95 % has the length of its component in phase with the formula.
    """
    square = cosine**2 + sine**2
    if square < _LENGTH_OF_NOISE**2 * spread**2:
        return max(0.0, cosine)
    return math.sqrt(square - spread**2) if math.isfinite(spread) else math.sqrt(square)
