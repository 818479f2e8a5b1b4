"""Measure how well `fit_scan` finds the pose, the scale and the waves of simulated scans, beside Open3D and trimesh.

    python benchmarks/scan_registration.py [--scans 200] [--small 200] [--foreign 10] [--peers 12] [--large 1]

The scan simulator gives the truth. There are five parts:

- Scans of 200,000 points with noise of 20 micrometres: six textures, both presets, three scales, any pose, half of the
  top or more, some of the walls, holes, outliers, a shrinkage, and a printer that loses short waves.
- Small scans of 3,000 points, for the coverage of the intervals of 95 %.
- Objects that are not the block, which must be refused: flats, other shapes, and blocks with another texture.
- Scans of prints without any error, also for Open3D (RANSAC with FPFH, then ICP from points to planes) and for
  `mesh_other` of trimesh. They know no scale, so this is their best case. A pose counts as found within 0.1 mm and 0.5
  degrees at the centre of the block.
- Time and memory for 2 million points, in a process of its own.

Open3D has 400 MB, so it is in an extra of its own: `pip install "tacbench-cad[bench-scan]"`. It needs the system
library libusb-1.0. Without it, its rows are left out. Directions that a scan does not determine are not part of the
errors. The last lines of the first table count them.
"""

from __future__ import annotations

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from helpers.scans import FOREIGN, foreign_scan

from tacbench_cad.extensions.scan.cloud import Cloud
from tacbench_cad.extensions.scan.estimates import ScanFit
from tacbench_cad.extensions.scan.fitting import fit_scan
from tacbench_cad.extensions.scan.pose import Pose
from tacbench_cad.extensions.scan.refining import centre_of
from tacbench_cad.extensions.scan.simulating import (
    WALLS,
    ScanTruth,
    low_pass,
    simulate_scan,
    stretch,
)
from tacbench_cad.geometry.block_part import block_part
from tacbench_cad.spec.block import Block
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Floats

SCALES = (0.5, 1.0, 2.0)
#: The goals: micrometres, degrees, scale.
GOAL_UM, GOAL_DEG, GOAL_SCALE = 5.0, 0.02, 2e-4


def case(number: int, points: int) -> tuple[Block, ScanTruth]:
    """Return the block and the truth of a random scan."""
    rng = np.random.default_rng((number, points))
    block = Block.of(number % 6 + 1, ("paper", "released")[number // 6 % 2], scale=SCALES[number // 12 % 3])
    scale = tuple(float(each) for each in 1.0 + rng.uniform(-0.006, 0.003, 3))
    truth = ScanTruth(
        pose=Pose(rotation=np.eye(3), shift_mm=np.zeros(3), stretch=stretch(scale)),  # type: ignore[arg-type]
        transfer_x=low_pass(rng.uniform(0.0, 0.5)),
        transfer_y=low_pass(rng.uniform(0.0, 0.5)),
        noise_mm=0.02,
        outlier_fraction=float(rng.uniform(0.0, 0.05)),
        top_fraction=float(rng.uniform(0.5, 1.0)),
        holes=int(rng.integers(0, 5)),
        hole_mm=float(rng.uniform(0.3, 1.5)) * block.scale,
        walls=tuple(wall for wall in WALLS if rng.random() < 0.6),
        wall_offset_mm=float(rng.uniform(-0.05, 0.15)),
        points=points,
        seed=number,
    )
    return block, truth.with_random_pose()


def pose_errors(pose: Pose, truth: Pose, block: Block) -> tuple[Floats, Floats]:
    """Return the rotation from the true pose to another in degrees, and the shift at the centre in mm, each (3,)."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_matrix(pose.rotation @ truth.rotation.T).as_rotvec(degrees=True)
    centre = centre_of(block)
    place = pose.to_print(((centre - truth.shift_mm) @ truth.rotation)[None])[0]
    return turn, place - centre


@dataclass
class Outcome:
    """What became of one scan. Errors and standard errors are by the names of the parameters."""

    number: int
    refused: str = ""
    found: bool = False
    listed: bool = False
    half_turn: str = "decided"
    error: dict[str, float] = field(default_factory=dict)
    standard_error: dict[str, float] = field(default_factory=dict)
    undetermined: tuple[str, ...] = ()
    #: For each wave: true ratio, error, standard error.
    waves: list[tuple[float, float, float]] = field(default_factory=list)
    seconds: float = 0.0


def near(pose: Pose, truth: Pose, block: Block, undetermined: tuple[str, ...], mm: float, degrees: float) -> bool:
    """Check whether a pose is right in the directions that are determined."""
    turn, place = pose_errors(pose, truth, block)
    return all(f"shift_{axis}_mm" in undetermined or abs(place[i]) < mm for i, axis in enumerate("xyz")) and all(
        f"rotation_{axis}_deg" in undetermined or abs(turn[i]) < degrees for i, axis in enumerate("xyz")
    )


def run(number: int, points: int) -> Outcome:
    """Simulate and fit one scan."""
    block, truth = case(number, points)
    cloud = simulate_scan(block, truth)
    outcome = Outcome(number)
    start = time.process_time()
    try:
        fit = fit_scan(cloud, block, "scale")
    except InputError as error:
        outcome.refused = str(error)
        return outcome
    finally:
        outcome.seconds = time.process_time() - start
    outcome.undetermined, outcome.half_turn = fit.undetermined, fit.half_turn
    pose, ratios = expected(fit, block, truth)
    coarse = (0.3, 1.5) if points < 10_000 else (0.1, 0.5)
    outcome.found = near(fit.pose, pose, block, fit.undetermined, *coarse)
    outcome.listed = outcome.found or any(
        near(other, pose, block, fit.undetermined, *coarse) for other in fit.alternatives
    )
    if outcome.found:
        collect(outcome, fit, block, truth, pose, ratios)
    return outcome


def expected(fit: ScanFit, block: Block, truth: ScanTruth) -> tuple[Pose, list[float]]:
    """Return the true pose and the true ratios of the waves, by the definitions of the fit.

    The scale along z can come from a wave, whose ratio is then 1 by definition. The scale and the other ratios are
    relative to this wave, and the shift is such that the mean height of the texture stays where it is.
    """
    assert truth.transfer_x is not None and truth.transfer_y is not None
    factors, reference = [], 1.0
    for wave in fit.waves:
        along = math.cos(math.radians(wave.direction_deg)) ** 2
        x, y = truth.transfer_x(wave.wavelength_mm), truth.transfer_y(wave.wavelength_mm)
        factors.append(along * x + (1.0 - along) * y)
        if wave.is_scale_reference:
            reference = factors[-1]
    changed = truth.pose.stretch.copy()
    changed[2, 2] *= reference
    rise = (changed[2, 2] - truth.pose.stretch[2, 2]) * block.datum_mm
    shift = truth.pose.shift_mm + np.array([0.0, 0.0, rise])
    return replace(truth.pose, stretch=changed, shift_mm=shift), [factor / reference for factor in factors]


def collect(outcome: Outcome, fit: ScanFit, block: Block, truth: ScanTruth, pose: Pose, ratios: list[float]) -> None:
    """Fill in the errors of the pose, the scale and the waves."""
    turn, place = pose_errors(fit.pose, pose, block)
    for i, axis in enumerate("xyz"):
        errors = {
            f"rotation_{axis}_deg": float(turn[i]),
            f"shift_{axis}_mm": float(place[i]),
            f"scale_{axis}": float(fit.pose.stretch[i, i] - pose.stretch[i, i]),
        }
        if axis == "x":
            errors["wall_offset_mm"] = fit.parameter("wall_offset_mm").value - truth.wall_offset_mm
        for name, error in errors.items():
            estimate = fit.parameter(name)
            if estimate.determined:
                outcome.error[name], outcome.standard_error[name] = error, estimate.standard_error
    for wave, ratio in zip(fit.waves, ratios, strict=True):
        if wave.determined and not wave.is_scale_reference:
            outcome.waves.append((ratio, wave.amplitude_ratio - ratio, wave.standard_error))


def numbered(call: Callable[[int], Any], count: int, what: str, options: argparse.Namespace) -> list[Any]:
    """Return the results of calls with numbers, of as many as the time allows, and show the progress."""
    end = time.monotonic() + 60.0 * options.minutes
    results: list[Any] = []
    with ProcessPoolExecutor(options.processes) as pool:
        for result in pool.map(call, range(count)):
            results.append(result)
            if sys.stderr.isatty():
                print(f"\r{what} {len(results)}/{count} ", end="", file=sys.stderr, flush=True)
            if time.monotonic() > end:
                pool.shutdown(wait=False, cancel_futures=True)
                break
    print(f"\n== {what}: {len(results)}")
    return results


def full_run(number: int) -> Outcome:
    return run(number, 200_000)


def small_run(number: int) -> Outcome:
    return run(number, 3_000)


def show_accuracy(outcomes: list[Outcome]) -> None:
    """Print success and errors of the scans of 200,000 points."""
    found = [one for one in outcomes if one.found]
    listed = sum(one.listed and not one.found for one in outcomes)
    refused = [one for one in outcomes if one.refused]
    print(f"pose found: {len(found)} of {len(outcomes)}; right only as a listed alternative: {listed}; ", end="")
    print(f"refused: {len(refused)}; wrong: {len(outcomes) - len(found) - listed - len(refused)}")
    for one in outcomes:
        if not one.found:
            block, truth = case(one.number, 200_000)
            kind = "refused" if one.refused else "listed" if one.listed else "WRONG"
            print(f"  {kind}: scan {one.number}, {block.name}, top {truth.top_fraction:.2f}, walls {truth.walls}, "
                  f"half turn {one.half_turn}; {one.refused[-120:]}")  # fmt: skip
    print(f"{'error':<18}{'number':>8}{'median':>10}{'95 %':>10}{'largest':>10}{'goal':>10}{'within':>9}")
    rows = [(f"shift_{axis}_mm", f"position {axis}, um", 1000.0, GOAL_UM) for axis in "xyz"]
    rows += [(f"rotation_{axis}_deg", f"angle {axis}, degrees", 1.0, GOAL_DEG) for axis in "xyz"]
    rows += [(f"scale_{axis}", f"scale {axis}, 1e-4", 1e4, 1e4 * GOAL_SCALE) for axis in "xyz"]
    rows.append(("wall_offset_mm", "walls, um", 1000.0, math.nan))
    for key, name, factor, goal in rows:
        errors = np.array([factor * abs(one.error[key]) for one in found if key in one.error])
        if len(errors):
            within = f"{np.mean(errors < goal):>9.1%}" if math.isfinite(goal) else ""
            print(f"{name:<18}{len(errors):>8}{np.median(errors):>10.3g}{np.quantile(errors, 0.95):>10.3g}"
                  f"{max(errors):>10.3g}{goal:>10g}{within}")  # fmt: skip
    waves = np.array([wave for one in found for wave in one.waves]).reshape(-1, 3)
    if not len(waves):
        return
    strong = waves[:, 0] > 150.0 * waves[:, 2]
    relative = np.abs(waves[:, 1]) / np.maximum(waves[:, 0], 1e-12)
    print(f"waves above 150 standard errors: {strong.sum()}, within 2 %: {np.mean(relative[strong] < 0.02):.1%}, "
          f"largest error {100.0 * relative[strong].max(initial=0.0):.2f} %")  # fmt: skip
    within = np.abs(waves[~strong, 1]) < 3.0 * waves[~strong, 2]
    print(f"other waves: {len(within)}, within 3 standard errors: {np.mean(within):.1%}")
    names = Counter((one.number % 6 + 1, name) for one in outcomes for name in one.undetermined)
    print("undetermined: " + ", ".join(f"texture {t} {name} {n}" for (t, name), n in sorted(names.items())))
    print(f"processor time: median {np.median([one.seconds for one in outcomes]):.2f} s, "
          f"largest {max(one.seconds for one in outcomes):.2f} s")  # fmt: skip


def show_coverage(outcomes: list[Outcome]) -> None:
    """Print the fraction of intervals that contain the truth."""
    found = [one for one in outcomes if one.found]
    listed = sum(one.listed and not one.found for one in outcomes)
    refused = sum(bool(one.refused) for one in outcomes)
    print(f"pose found: {len(found)} of {len(outcomes)}, listed: {listed}, refused: {refused}")
    ratios: dict[str, list[float]] = {}
    for one in found:
        for name, error in one.error.items():
            ratios.setdefault(name, []).append(abs(error) / one.standard_error[name])
        for true, error, spread in one.waves:
            ratios.setdefault("waves above 5 standard errors" if true > 5 * spread else "other waves", []).append(
                abs(error) / spread
            )
    everything = [ratio for values in ratios.values() for ratio in values]
    for name, values in [*sorted(ratios.items()), ("all", everything)]:
        print(f"{name:<32}{len(values):>8} intervals, {np.mean(np.array(values) < 1.96):>7.1%} contain the truth")


def foreign_run(number: int) -> tuple[str, str]:
    """Return the kind of an object, and the error by which it was refused; empty if it was not."""
    block = Block.of(number % 6 + 1, ("paper", "released")[number // 6 % 2])
    kinds = (*FOREIGN, "other texture")
    kind = kinds[number % len(kinds)]
    if kind == "other texture":
        other = Block.of((number + 1 + number // len(kinds) % 5) % 6 + 1, block.preset)
        cloud = simulate_scan(other, ScanTruth(points=50_000, seed=number).with_random_pose())
        kind += f" ({other.texture.name} for {block.texture.name})"
    else:
        cloud = foreign_scan(kind, seed=number)
    try:
        fit_scan(cloud, block)
    except InputError as error:
        return kind, str(error)
    return kind, ""


def by_ours(cloud: Cloud, block: Block) -> Pose:
    return fit_scan(cloud, block, "pose").pose


def by_trimesh(cloud: Cloud, block: Block) -> Pose:
    """Register with the principal axes and ICP of trimesh."""
    import trimesh
    from trimesh.registration import mesh_other

    mesh = block_part(block).mesh[0]
    body = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    matrix, _ = mesh_other(body, cloud.points_mm[:1000], samples=1000, reflection=False, seed=0)
    return pose_of(np.linalg.inv(matrix))


def by_open3d(cloud: Cloud, block: Block) -> Pose:
    """Register with FPFH features, RANSAC and ICP of Open3D, with the settings of its own tutorial."""
    import open3d

    registration = open3d.pipelines.registration
    whole = simulate_scan(block, ScanTruth(noise_mm=0.0, points=200_000)).points_mm
    voxel = math.hypot(*block.size_mm) / 60.0
    open3d.utility.random.seed(0)

    def prepared(points: Floats) -> tuple[Any, Any, Any]:
        fine = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        coarse = fine.voxel_down_sample(voxel)
        for each in (fine, coarse):
            each.estimate_normals(open3d.geometry.KDTreeSearchParamHybrid(radius=2.0 * voxel, max_nn=30))
        around = open3d.geometry.KDTreeSearchParamHybrid(radius=5.0 * voxel, max_nn=100)
        return fine, coarse, registration.compute_fpfh_feature(coarse, around)

    fine, coarse, features = prepared(cloud.points_mm)
    fine_block, coarse_block, block_features = prepared(whole)
    reach = 1.5 * voxel
    checks = [
        registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
        registration.CorrespondenceCheckerBasedOnDistance(reach),
    ]
    rough = registration.registration_ransac_based_on_feature_matching(
        coarse, coarse_block, features, block_features, True, reach,
        registration.TransformationEstimationPointToPoint(False), 3, checks,
        registration.RANSACConvergenceCriteria(100_000, 0.999),
    )  # fmt: skip
    result = registration.registration_icp(
        fine, fine_block, 0.4 * voxel, rough.transformation, registration.TransformationEstimationPointToPlane()
    )
    return pose_of(np.asarray(result.transformation))


def pose_of(matrix: Floats) -> Pose:
    return Pose(rotation=matrix[:3, :3].copy(), shift_mm=matrix[:3, 3].copy(), stretch=np.eye(3))


def compare_with_peers(count: int) -> None:
    """Print how often each program finds the pose of prints without any error, and how well."""
    programs: dict[str, Callable[[Cloud, Block], Pose]] = {"tacbench": by_ours}
    for name, call in (("open3d", by_open3d), ("trimesh", by_trimesh)):
        try:
            __import__(name)
            programs[name] = call
        except ImportError as error:
            print(f"{name} IS LEFT OUT, because it cannot be imported ({error}): pip install {name}")
    print(f"{'program':<10}{'scans':<10}{'found':>9}{'median um':>11}{'median deg':>12}{'median s':>10}")
    for what, top, walls in (("complete", 1.0, WALLS), ("partial", 0.6, ("x-", "y-"))):
        results: dict[str, list[tuple[float, float, float]]] = {name: [] for name in programs}
        for number in range(count):
            block = Block.of(number % 6 + 1, ("paper", "released")[number // 6 % 2])
            truth = ScanTruth(seed=number, top_fraction=top, walls=walls, points=100_000)  # type: ignore[arg-type]
            truth = truth.with_random_pose()
            cloud = simulate_scan(block, truth)
            for name, call in programs.items():
                start = time.process_time()
                try:
                    turn, place = pose_errors(call(cloud, block), truth.pose, block)
                except InputError:
                    turn = place = np.full(3, np.inf)
                seconds = time.process_time() - start
                results[name].append((float(np.linalg.norm(place)), float(np.linalg.norm(turn)), seconds))
        for name, rows in results.items():
            table = np.array(rows)
            found = (table[:, 0] < 0.1) & (table[:, 1] < 0.5)
            mm, degrees = np.median(table[found, :2], axis=0) if found.any() else (math.nan, math.nan)
            print(f"{name:<10}{what:<10}{found.sum():>4} of {len(rows):<3}{1000.0 * mm:>10.2f}{degrees:>12.4f}"
                  f"{np.median(table[:, 2]):>10.2f}")  # fmt: skip


def measure_large(texture: int) -> None:
    """Print time and memory for 2 million points, in a process of its own."""
    block = Block.of(texture)
    truth = replace(case(0, 10)[1], points=2_000_000, walls=WALLS, top_fraction=1.0, hole_mm=0.5).with_random_pose()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scan.npy"
        np.save(path, simulate_scan(block, truth).points_mm)
        words = [sys.executable, __file__, "--measure", str(path), "--texture", str(texture)]
        print(subprocess.run(words, check=True, capture_output=True, text=True).stdout, end="")


def measure(path: Path, texture: int) -> None:
    points = np.load(path)
    start, processor = time.perf_counter(), time.process_time()
    fit = fit_scan(Cloud(points_mm=points, source=path.name), Block.of(texture))
    seconds, processor = time.perf_counter() - start, time.process_time() - processor
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f"texture {texture}, {len(points):,} points, {len(fit.waves)} waves: {seconds:.1f} s, "
          f"{processor:.1f} s of processor time, {peak:.0f} MB")  # fmt: skip


def main() -> None:
    """Run the parts and print their tables."""
    parser = argparse.ArgumentParser()
    for name, count in (("scans", 200), ("small", 200), ("foreign", 10), ("peers", 12), ("large", 1), ("processes", 2)):
        parser.add_argument(f"--{name}", type=int, default=count)
    parser.add_argument("--minutes", type=float, default=math.inf, help="the time for each of the first three parts")
    parser.add_argument("--save", type=Path, help="a JSON file for the outcomes")
    parser.add_argument("--measure", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--texture", type=int, default=2, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.measure:
        measure(options.measure, options.texture)
        return
    saved: dict[str, Any] = {}
    if options.scans:
        outcomes = numbered(full_run, options.scans, "scans of 200,000 points", options)
        saved["scans"] = [vars(one) for one in outcomes]
        show_accuracy(outcomes)
    if options.small:
        outcomes = numbered(small_run, options.small, "small scans of 3,000 points", options)
        saved["small"] = [vars(one) for one in outcomes]
        show_coverage(outcomes)
    if options.foreign:
        results = numbered(foreign_run, options.foreign * (len(FOREIGN) + 1), "foreign objects", options)
        saved["foreign"] = results
        print(f"refused: {sum(bool(error) for _, error in results)} of {len(results)}")
        for number, (kind, error) in enumerate(results):
            if not error:
                print(f"  ACCEPTED: object {number}, {kind}")
    if options.peers:
        print("\n== beside other programs")
        compare_with_peers(options.peers)
    if options.large:
        print("\n== large scans")
        for texture in (2, 4):
            measure_large(texture)
    if options.save:
        options.save.write_text(json.dumps(saved))


if __name__ == "__main__":
    main()
