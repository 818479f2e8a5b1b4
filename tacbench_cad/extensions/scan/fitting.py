"""Fitting a scan to a block: which block it is, how it lies, how it was printed, each with an interval or a refusal."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from tacbench_cad.extensions.scan import fine
from tacbench_cad.extensions.scan.cloud import Cloud
from tacbench_cad.extensions.scan.coarse import SEARCH_POINTS, Search, Seen, look, verticals
from tacbench_cad.extensions.scan.estimates import FITS, Fit, ScanFit
from tacbench_cad.extensions.scan.faces import NOTHING, TOP, WALL, assign, walls_of
from tacbench_cad.extensions.scan.fine import COMPARED_POINTS, FIRST_POINTS, Rough, cost, thinned
from tacbench_cad.extensions.scan.height_model import Relief
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.extensions.scan.refining import (
    TUKEY,
    State,
    Unknowns,
    chunks,
    errors,
    normal_equations,
    solve,
    trimmed_deviation,
    variance,
)
from tacbench_cad.spec import Block, distance_along_normal
from tacbench_cad.util.errors import InputError, one_of
from tacbench_cad.util.types import Floats

#: The smallest number of points of a scan.
MIN_POINTS = 500
#: The number of points that decide between poses.
_DECIDING_POINTS = 8_000
#: Two poses explain a scan equally well if their log-likelihoods differ by less than this.
_EQUAL = 40.0
#: The largest number of poses that are compared with all waves.
_MAX_COMPARED = 16
#: A vertical is accepted without trying the others if its pose explains this fraction of the points.
_ENOUGH = 0.85
#: The number of candidates that are compared by their distances, after a comparison of heights.
_MAX_LOCATED = 5
#: The smallest fraction of the points in the box of the block that must lie on its faces.
_MIN_EXPLAINED = 0.8
#: The largest fraction of the variance of the relief that may remain at the points of the top.
_MAX_LEFT = 0.25
#: If at least half of the points are explained, but more than the first fraction is not, the mirror images of the scan
#: are tried. The scan is refused if one of them explains more by the second fraction.
_UNEXPLAINED, _MIRROR_GAIN = 0.03, 0.02
#: The allowed range of scales.
_SCALES = (0.9, 1.1)

Progress = Callable[[str, float], None]


@dataclass(frozen=True, eq=False)
class _Located:
    """A pose that may be right, after the first steps, and the fraction of the points that it explains."""

    state: State
    cost: float
    explained: float


def fit_scan(cloud: Cloud, block: Block, fit: Fit = "scale", *, progress: Progress | None = None) -> ScanFit:
    """Find how a scan lies on a block, and fit the print to the formula.

    The start needs no hint: see :mod:`tacbench_cad.extensions.scan.coarse`. The end is exact: see
    :mod:`tacbench_cad.extensions.scan.refining`. Where the scan is a height map, its heights point up. Where several
    poses explain the scan equally well, the pose whose top points most towards +z of the scan is taken and the others
    are listed.

    Args:
        cloud: The scan.
        block: The block as designed.
        fit: ``pose``; ``scale`` for the scales along x, y and z as well; ``square`` for the skew as well.
        progress: Is called with the step and the fraction of the work that is done.

    Raises:
        InputError: The scan has too few points, or it does not show this block.
    """
    one_of("fit", fit, FITS)
    tell = progress or (lambda step, fraction: None)
    points = _checked(cloud)
    tell("finding the block", 0.0)
    seen = look(thinned(points, SEARCH_POINTS))
    located = _locate(seen, Search(block), upright=cloud.grid is not None)
    if not located:
        raise _refused(cloud, block, "no pose explains its relief")
    tell("comparing the poses", 0.3)
    shortest = fine.PIXELS_IN_WAVE * max(cloud.grid.step_mm) if cloud.grid else 0.0
    best, rivals = _decide(points, block, fit, located, shortest)
    _refuse_mirrored(cloud, block, located)
    tell("fitting", 0.6)
    limit = _limit(block)
    some = thinned(points, COMPARED_POINTS)
    state, unknown = fine.refined(some, block, best[0], fit, limit, shortest)
    state = _centred(some, block, state, unknown, limit)
    final = fine.finish(points, block, state, unknown, limit, blur=cloud.grid is None)
    _require_block(cloud, block, points, final, limit)
    tell("measuring all points", 0.9)
    return _result(points, block, fit, final, rivals, limit)


def identify(cloud: Cloud, candidates: Sequence[Block]) -> tuple[Block, ScanFit]:
    """Find which of several blocks a scan shows.

    Args:
        cloud: The scan.
        candidates: The blocks that it may show.

    Returns:
        The block, and the fit of the scan to it, with the scale.

    Raises:
        InputError: There is no candidate, or the scan shows none of them, such as a flat or another object.
    """
    if not candidates:
        raise InputError("candidates", [], "must name at least one block")
    points = _checked(cloud)
    seen = look(thinned(points, SEARCH_POINTS))
    few = thinned(points, FIRST_POINTS)
    cut = 0.25 * min(Rough.of(block).reliefs[0].rms_mm for block in candidates)
    searches = [Search(block) for block in candidates]
    scores = [_score(seen, search, upright=cloud.grid is not None) for search in searches]
    costs = [math.inf] * len(candidates)
    for index in np.argsort(scores)[::-1][:_MAX_LOCATED]:
        block = candidates[index]
        for entry in _locate(seen, searches[index], upright=cloud.grid is not None, most=2)[:2]:
            state, _ = fine.simple(few, block, entry.state, "scale", _limit(block))
            costs[index] = min(costs[index], math.sqrt(float(np.mean(cost(few, block, state, cut)))))
    order = np.argsort(costs)
    reason: InputError | None = None
    for index in order[:3]:
        if math.isfinite(costs[index]):
            try:
                return candidates[index], fit_scan(cloud, candidates[index], "scale")
            except InputError as error:
                reason = reason or error
    raise reason or _refused(cloud, candidates[int(order[0])], "no pose explains its relief")


def _checked(cloud: Cloud) -> Floats:
    if len(cloud.points_mm) < MIN_POINTS:
        raise InputError(
            cloud.source, None, f"has {len(cloud.points_mm)} points; a scan needs at least {MIN_POINTS} points"
        )
    return cloud.points_mm


def _refused(cloud: Cloud, block: Block, why: str) -> InputError:
    return InputError(
        cloud.source,
        None,
        f"does not show {block.name}: {why}. Check the block, the units, and that at least half of the top was scanned",
    )


def _score(seen: Seen, search: Search, *, upright: bool) -> float:
    """Return how well the heights of a scan agree with a block at best, over the likely verticals."""
    best = 0.0
    for vertical in itertools.islice(verticals(seen, search.block), 2):
        for sign in (1.0, -1.0):
            if not upright or sign * vertical[2] >= 0.7:
                best = max([best, *(score for score, _ in search.poses(seen, sign * vertical))])
    return best


def _locate(seen: Seen, search: Search, *, upright: bool, most: int = 6) -> list[_Located]:
    """Return the poses that may be right, the best first, from at most ``most`` verticals."""
    block, steps = search.block, Rough.of(search.block)
    few = thinned(seen.points, FIRST_POINTS)
    cut = 0.3 * steps.reliefs[0].rms_mm
    result: list[_Located] = []
    for vertical in itertools.islice(verticals(seen, block), most):
        for sign in (1.0, -1.0):
            if upright and sign * vertical[2] < 0.7:
                continue
            for _, pose in search.poses(seen, sign * vertical):
                state = steps(few, pose)
                squares = cost(few, block, state, cut)
                # A wrong place along a side may have been taken for an offset of the walls, so this starts at zero.
                moves = [replace(state, pose=aligned, wall_offset_mm=0.0) for aligned in _aligned(few, block, state)]
                if moves:
                    best = min(moves, key=lambda move: float(np.sum(cost(few, block, move, cut))))
                    other = steps(few, best.pose)
                    less = cost(few, block, other, cut)
                    if float(np.sum(less)) < float(np.sum(squares)):
                        state, squares = other, less
                result.append(_Located(state, float(np.mean(squares)), float(np.mean(squares < 0.99 * cut**2))))
        if result and max(entry.explained for entry in result) > _ENOUGH:
            break
    result.sort(key=lambda entry: entry.cost)
    kept: list[_Located] = []
    for entry in result:
        if entry.explained > 0.5 * result[0].explained and not any(
            _close(entry.state.pose, other.state.pose, block) for other in kept
        ):
            kept.append(entry)
    return kept


def _aligned(points: Floats, block: Block, state: State) -> Iterator[Pose]:
    """Return the pose moved along a side along which the texture is constant, so that edges or walls come to the ends.

    The walls are where most of the points below the top lie.
    """
    nominal = state.pose.to_block(points)
    limit = _limit(block)
    top = assign(nominal, block, state.relief, limit, max(block.size_mm)).face == TOP
    below = ~top & (nominal[:, 2] > 0.0) & (nominal[:, 2] < block.height_mm)
    for axis in range(2):
        if block.surface.highest_frequency[axis] > 0.0 or not top.any():
            continue
        places = list(np.quantile(nominal[top, axis], (0.003, 0.997)))
        if below.any():
            along, bin_mm = nominal[below, axis], 0.01 * block.size_mm[axis]
            counts, edges = np.histogram(along, np.arange(-100.0, 200.0) * bin_mm)
            fullest = np.argsort(counts)[-2:]
            middles = edges[fullest[counts[fullest] > 0]] + 0.5 * bin_mm
            places += [float(np.median(along[np.abs(along - middle) < bin_mm])) for middle in middles]
        for place in places:
            for end in (0.0, block.size_mm[axis]):
                shift = state.pose.shift_mm.copy()
                shift[axis] += end - place
                yield replace(state.pose, shift_mm=shift)


def _close(first: Pose, second: Pose, block: Block, fraction: float = 0.03) -> bool:
    """Return whether two poses put the corners of the block at almost the same places of the scan."""
    x, y = block.size_mm
    corners = np.array([[0.0, 0.0, 0.0], [x, 0.0, 0.0], [0.0, y, 0.0], [x, y, block.height_mm]])
    far = np.linalg.norm(first.to_scan(corners) - second.to_scan(corners), axis=1)
    return bool(far.max() < fraction * max(x, y))


def _limit(block: Block) -> float:
    """Return the largest distance from a face at which points still count in the fine steps."""
    return 0.3 * Relief.of(block).rms_mm + 0.05


def _decide(
    points: Floats, block: Block, fit: Fit, located: list[_Located], shortest_mm: float
) -> tuple[tuple[State, Unknowns], tuple[Pose, ...]]:
    """Return the best state, and the poses that explain the scan equally well.

    A pose loses if it leaves points beside the top or beside the walls, which is how a shift by a whole wavelength is
    excluded. Poses that differ only along undetermined directions are the same.
    """
    some = thinned(points, _DECIDING_POINTS)
    results: list[tuple[State, Unknowns]] = []
    limit = _limit(block)
    most = 1.5 * located[0].cost + (0.02 * limit) ** 2
    for entry in [entry for entry in located if entry.cost <= most or entry is located[0]][:_MAX_COMPARED]:
        state, unknown = fine.refined(some, block, entry.state, fit, limit, shortest_mm)
        state = _centred(some, block, state, unknown, limit)
        if not any(_close(state.pose, other.pose, block, 0.02) for other, _ in results):
            results.append((state, unknown))
    # The noise is that of the pose that explains most. Another pose may follow a few points without any noise.
    leader = min((state for state, _ in results), key=lambda state: float(np.sum(cost(some, block, state, limit))))
    noise = max(leader.depth_mm, leader.lateral_mm, 1e-4)
    cut = TUKEY * noise
    loss = [float(np.sum(cost(some, block, state, cut))) / (2.0 * noise**2) for state, _ in results]
    equal = [entry for entry, value in zip(results, loss, strict=True) if value < min(loss) + _EQUAL]
    equal.sort(key=lambda entry: -float(entry[0].pose.rotation[2, 2]))
    return equal[0], tuple(state.pose for state, _ in equal[1:])


def _centred(points: Floats, block: Block, state: State, unknown: Unknowns, limit: float) -> State:
    """Put the points of the top in the middle of the block along a side if nothing else says where they are.

    If only one wall says it, nothing tells a shift from an offset of the walls, and the offset is taken as zero.
    """
    normal = normal_equations(points[:: max(1, len(points) // 4000)], block, state, unknown, limit)
    known = dict(zip(unknown.names, solve(normal, unknown, block).determined, strict=False))
    shift = state.pose.shift_mm.copy()
    nominal = state.pose.to_block(points)
    assigned = assign(nominal, block, state.relief, limit, 0.25 * max(block.size_mm))
    top = assigned.face == TOP
    walls = [wall for index, wall in enumerate(walls_of(block)) if WALL + index in state.faces]
    offset = state.wall_offset_mm if known.get("wall_offset_mm") else 0.0
    for axis in range(2):
        if known[f"shift_{'xy'[axis]}_mm"]:
            continue
        beside = [wall.normal[axis] for wall in walls if wall.normal[axis]]
        if beside:
            shift[axis] -= (state.wall_offset_mm - offset) * beside[0]
        elif top.any():
            low, high = np.quantile(nominal[top, axis], (0.005, 0.995))
            shift[axis] -= (low + high) / 2.0 - block.size_mm[axis] / 2.0
    return replace(state, pose=replace(state.pose, shift_mm=shift), wall_offset_mm=offset)


def _refuse_mirrored(cloud: Cloud, block: Block, located: list[_Located]) -> None:
    """Refuse a scan whose mirror image fits much better.

    The mirror image of a block mostly fits as well, but with an overhang. If a texture is constant along a side, its
    mirror image is the block itself.

    Raises:
        InputError: An axis of the scan is reversed.
    """
    if not all(block.surface.highest_frequency):
        return
    upright = cloud.grid is not None
    now = max(entry.explained for entry in located)
    if not 0.5 < now < 1.0 - _UNEXPLAINED:
        return
    mirrors = {"its rows are in reversed order" if upright else "one of its axes is reversed": (1.0, -1.0, 1.0)}
    if upright:
        mirrors["its heights have the wrong sign"] = (1.0, 1.0, -1.0)
    for why, signs in mirrors.items():
        mirrored = look(thinned(cloud.points_mm, SEARCH_POINTS) * signs)
        others = _locate(mirrored, Search(block), upright=upright)
        better = max((entry.explained for entry in others), default=0.0)
        if better > max(now + _MIRROR_GAIN, _MIN_EXPLAINED):
            raise InputError(
                cloud.source,
                None,
                f"shows the mirror image of {block.name}: {why}. Its mirror image fits better ({better:.0%} of the "
                f"points instead of {now:.0%}). Export the scan again",
            )


def _require_block(cloud: Cloud, block: Block, points: Floats, final: fine.Final, limit: float) -> None:
    """Refuse a scan that does not show the block.

    Raises:
        InputError: The scan shows a flat or another object.
    """
    some = thinned(points, COMPARED_POINTS)
    state = final.state
    nominal, assigned = state.assigned(some, block, limit)
    top = assigned.face == TOP
    low, high = np.zeros(3) - limit, np.array([*block.size_mm, block.height_mm]) + limit
    box = np.all((nominal > low) & (nominal < high), axis=1)
    explained = float(np.mean(assigned.face[box] != NOTHING)) if box.any() else 0.0
    if np.count_nonzero(top) < 100 or explained < _MIN_EXPLAINED:
        raise _refused(cloud, block, f"only {explained:.0%} of the points in its box lie on its faces")
    if np.count_nonzero(box) < 0.3 * len(some):
        raise _refused(cloud, block, f"only {np.mean(box):.0%} of the points lie in its box")
    height = state.relief(*nominal[top, :2].T)[0]
    left = trimmed_deviation(errors(assigned, state)[top] / np.sqrt(1.0 + assigned.slope2[top])) ** 2
    if left > _MAX_LEFT * float(np.var(height)) or np.std(height) < 0.3 * Relief.of(block).rms_mm:
        raise _refused(cloud, block, "its relief differs from the formula")
    scales = np.diag(state.pose.stretch)
    if not np.all((scales > _SCALES[0]) & (scales < _SCALES[1])):
        shown = ", ".join(f"{scale:.3g}" for scale in scales)
        raise _refused(cloud, block, f"it would have to be printed at a scale of {shown}")
    if len(state.relief.fitted) and final.unknown.waves:
        amplitude, f, g, _ = state.relief.surface.table.T  # type: ignore[attr-defined]
        weight = np.abs(amplitude) * ((f != 0.0) | (g != 0.0))
        # A print keeps the strong waves of every direction, and it keeps them in phase with the formula.
        ratio = 1.0 + state.relief.changes[:, 0]
        direction = np.round(np.degrees(np.arctan2(g, f)) % 180.0)
        for same in (direction == each for each in np.unique(direction)):
            share = float(np.sum(weight[same]))
            if share > 0.25 * weight.sum() and not 0.5 < float(weight[same] @ ratio[same]) / share < 1.5:
                raise _refused(cloud, block, "the amplitudes of its waves differ from the formula")


def _half_turn(pose: Pose, others: tuple[Pose, ...]) -> Literal["decided", "undecidable"]:
    for other in others:
        turn = other.rotation @ pose.rotation.T
        if turn[2, 2] > 0.9 and turn[0, 0] < -0.9:
            return "undecidable"
    return "decided"


def _result(
    points: Floats, block: Block, fit: Fit, final: fine.Final, rivals: tuple[Pose, ...], limit: float
) -> ScanFit:
    state = final.state
    count = len(points)
    face, distance = np.empty(count, dtype=np.int8), np.empty(count)
    used = np.zeros(count, dtype=bool)
    plain = Relief.of(block)
    reach = 3.0 * limit
    for part in chunks(count):
        nominal, fitted = state.assigned(points[part], block, reach)
        rest = errors(fitted, state)
        used[part] = np.nan_to_num(rest**2, nan=math.inf) < TUKEY**2 * variance(fitted, state)
        face[part] = fitted.face
        outward = fitted.normal[:, :2] ** 2 @ state.wall_offsets_mm
        distance[part] = fitted.error_mm + outward * (fitted.face >= WALL)
        top = fitted.face == TOP
        distance[part][top] = distance_along_normal(nominal[top], plain)
    on_top, on_walls = face == TOP, face >= WALL
    distance[~(on_top | on_walls)] = np.nan
    return ScanFit(
        fit=fit,
        pose=state.pose,
        parameters=fine.estimates(final, block),
        on_top=on_top,
        on_walls=on_walls,
        used=used & (on_top | on_walls),
        deviation_mm=distance,
        noise_mm=state.depth_mm,
        half_turn=_half_turn(state.pose, rivals),
        alternatives=rivals,
        waves=fine.wave_estimates(state.relief, final.unknown, final.standard_error[len(final.unknown.names) :]),
        correlation=final.correlation,
    )
