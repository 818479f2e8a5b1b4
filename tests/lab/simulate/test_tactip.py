"""Measure the simulated TacTip's images with OpenCV as a user would, and test its devices."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tacbench_cad.lab.rig.clock import Clock
from tacbench_cad.lab.rig.frames import frame_faults
from tacbench_cad.lab.rig.gauge import Gauge
from tacbench_cad.lab.rig.sensor import Sensor
from tacbench_cad.lab.simulate.appearances import CLEAN
from tacbench_cad.lab.simulate.contact import DomeContact, contact_for
from tacbench_cad.lab.simulate.heights import flat_plate
from tacbench_cad.lab.simulate.rendering import with_noise
from tacbench_cad.lab.simulate.simulated_devices import GAUGE_NOISE_N, SimulatedGauge, SimulatedSensor
from tacbench_cad.lab.simulate.tactip import Skin, TacTip
from tacbench_cad.lab.study.spec import HolderRim, Point, PrintedBlock, WorkFrame
from tacbench_cad.spec.block import Block
from tacbench_cad.spec.protocol import FORCES_N
from tacbench_cad.spec.skin import INNER_RADIUS_MM, pin_shifts_px, shift_px_per_mm
from tacbench_cad.util.errors import InputError
from tacbench_cad.util.types import Bytes, Floats

FAST = Clock(speed=1e6)
RINGS = CLEAN.rings
REST = TacTip().rest
#: The standard deviation of the noise of a clean frame, in counts.
((_, READ_NOISE),) = CLEAN.noise
HOLDER = HolderRim()
PLATE = DomeContact(flat_plate())
GROUNDS = {
    number: contact_for(PrintedBlock(block=Block.of(number), printer="form-3", filament="grey-v4"), HOLDER)
    for number in range(1, 7)
}


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.Generator(np.random.SFC64(seed))


def _pressed(contact: DomeContact, force_n: float, x: float = 6.5, y: float = 20.5) -> Point:
    return (x, y, contact.z_for_force(x, y, force_n))


def _markers(image: Bytes) -> Floats:
    """Return the centroids (column, row) of the bright spots, weighted by brightness."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    count, labels = cv2.connectedComponents((grey > 20).astype(np.uint8))
    weight = np.where(grey > 20, grey, 0).astype(np.float64)
    rows, columns = np.indices(grey.shape)
    mass = np.bincount(labels.ravel(), weight.ravel(), minlength=count)[1:]
    sums = (np.bincount(labels.ravel(), (weight * at).ravel(), minlength=count)[1:] for at in (columns, rows))
    return np.stack([total / mass for total in sums], axis=1)


@pytest.mark.parametrize("colour", [False, True])
def test_at_rest_the_markers_match_the_pinhole_camera(colour: bool) -> None:
    markers = _markers(TacTip(colour=colour).image(None, (0.0, 0.0, 0.0), _rng()))
    assert len(markers) == 133
    for count, first, step, r, z in RINGS:
        for i in range(count):
            azimuth = math.radians(first + step * i)
            radius = 601.0 * r / (48.9 + z)
            place = (319.5 + radius * math.cos(azimuth), 239.5 - radius * math.sin(azimuth))
            assert np.min(np.hypot(*(markers - place).T)) < 0.3


def test_the_rings_have_the_radii_measured_on_images() -> None:
    radii = np.sort(np.hypot(*(_markers(TacTip().image(None, (0, 0, 0), _rng())) - (319.5, 239.5)).T))
    means = [ring.mean() for ring in np.split(radii, np.cumsum([count for count, *_ in RINGS])[:-1])]
    assert means[-1] == pytest.approx(143.0, abs=1.5)
    measured = (0.216, 0.320, 0.454, 0.599, 0.728, 0.855, 1.0)
    assert np.array(means[1:]) / means[-1] == pytest.approx(measured, abs=0.02)


@pytest.mark.parametrize("number", sorted(GROUNDS))
def test_the_deformation_grows_with_the_force(number: int) -> None:
    contact, sensor = GROUNDS[number], TacTip()
    distances = []
    for force in FORCES_N:
        tips = sensor.pins(contact, _pressed(contact, force)).tips_mm
        distances.append(np.linalg.norm(sensor.camera.pixels(tips) - sensor.camera.pixels(REST.tips_mm), axis=1).mean())
    assert 0.05 < distances[0] < distances[1] < distances[2] < 20.0


def test_frames_of_equal_poses_differ_by_noise_only() -> None:
    contact, sensor = GROUNDS[3], TacTip(colour=False, flicker=0.0)
    pose = _pressed(contact, FORCES_N[2])
    first, second = (sensor.image(contact, pose, _rng(seed)).astype(float) for seed in (1, 2))
    assert np.mean(first - second) == pytest.approx(0.0, abs=0.02)
    bright = (first > 100) & (second > 100)
    assert np.std((first - second)[bright]) == pytest.approx(READ_NOISE * math.sqrt(2.0), rel=0.03)
    assert np.max(np.abs(first - second)) <= 2 * 4
    assert np.array_equal(first, sensor.image(contact, pose, _rng(1)))


def test_different_textures_differ_by_more_than_noise() -> None:
    sensor = TacTip(colour=False)
    images = [
        sensor.image(contact, _pressed(contact, FORCES_N[2]), _rng(number)).astype(float)
        for number, contact in GROUNDS.items()
    ]
    for i, image in enumerate(images):
        for other in images[:i]:
            assert np.mean((image - other) ** 2) > 10.0 * READ_NOISE**2


def test_flicker_changes_all_pins_together() -> None:
    still, lively = TacTip(colour=False, flicker=0.0), TacTip(colour=False, flicker=0.05)
    pins = still.image(None, (0, 0, 0), _rng()) > 100

    def brightness_deviation(sensor: TacTip) -> float:
        return float(np.std([sensor.image(None, (0, 0, 0), _rng(seed))[pins].mean() for seed in range(30)]))

    assert brightness_deviation(still) < 0.1
    assert 5.0 < brightness_deviation(lively) < 15.0


def test_read_noise_has_the_stated_size_and_is_clipped_at_the_ends() -> None:
    grey = np.full((480, 640), 100, dtype=np.uint8)
    noisy = with_noise(grey, CLEAN, _rng()).astype(float)
    assert np.std(noisy) == pytest.approx(READ_NOISE, rel=0.01)
    assert np.mean(noisy) == pytest.approx(100.0, abs=0.01)
    assert with_noise(np.zeros_like(grey), CLEAN, _rng()).min() == 0
    assert with_noise(np.full_like(grey, 255), CLEAN, _rng()).max() == 255


def test_the_background_is_near_zero_and_the_frame_has_no_faults() -> None:
    sensor = TacTip()
    image = sensor.image(GROUNDS[4], _pressed(GROUNDS[4], FORCES_N[2]), _rng())
    assert image.shape == sensor.shape == (480, 640, 3) and image.dtype == np.uint8
    assert np.median(image) <= 4
    assert frame_faults(image, sensor.image(None, (0, 0, 0), _rng(1))) == ()
    assert TacTip(colour=False).shape == (480, 640)


def test_without_contact_nothing_moves() -> None:
    sensor = TacTip()
    assert sensor.pins(GROUNDS[1], (6.5, 20.5, 5.0)) is sensor.rest
    assert sensor.pins(None, (0.0, 0.0, -3.0)) is sensor.rest


def test_on_a_plate_middle_pins_move_up_and_outer_pins_outwards() -> None:
    contact = DomeContact(flat_plate())
    displacement = TacTip().pins(contact, _pressed(contact, FORCES_N[1], 0.0, 0.0)).tips_mm - REST.tips_mm
    assert displacement[0, 2] < -1.0 and np.hypot(*displacement[0, :2]) < 1e-3
    outward = np.sum(displacement[:, :2] * REST.tips_mm[:, :2], axis=1)
    assert np.all(outward[1:25] > 0.0)
    rings = np.split(np.linalg.norm(displacement[1:], axis=1), np.cumsum([count for count, *_ in RINGS[1:]])[:-1])
    for ring in rings:
        assert np.ptp(ring) < 0.02
    assert rings[-1].max() < 0.05


def test_the_skin_spreads_without_loss_and_its_gradient_equals_the_slope() -> None:
    step = 1e-3
    places = np.array([[0.0, 0.0], [step, 0.0], [0.0, step], [8.0, 0.0], [5.5, 1.0], [5.5 + step, 1.0]])
    skin = Skin(places)
    at = np.arange(-6.95, 7.0, 0.1)
    depth = np.where(np.hypot(at[None, :], at[:, None]) < 6.0, 1.0, 0.0)
    w, slope = skin.displacement(depth, at, at, 0.1)
    assert 0.9 < w[0] < 1.0
    assert 0.01 < w[3] < 0.2
    assert (w[1] - w[0]) / step == pytest.approx(slope[0, 0], abs=1e-3)
    assert (w[5] - w[4]) / step == pytest.approx(slope[4, 0], rel=1e-2)
    assert slope[4, 0] < -0.1


def test_the_skin_keeps_its_volume() -> None:
    at = np.arange(-20.0, 20.5, 0.5)
    places = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    small = np.array([0.05, 0.15])
    w, _ = Skin(places).displacement(np.ones((2, 2)), small, small, 0.1)
    assert np.sum(w) * 0.25 == pytest.approx(0.04, rel=0.02)


def test_pins_are_inside_the_skin() -> None:
    assert len(REST.tips_mm) == 133
    assert np.all(np.linalg.norm(REST.tips_mm, axis=1) < INNER_RADIUS_MM)
    assert np.linalg.norm(REST.facing, axis=1) == pytest.approx(1.0)


@pytest.mark.parametrize("flicker", [-0.1, math.nan])
def test_an_impossible_light_is_refused(flicker: float) -> None:
    with pytest.raises(InputError, match="flicker"):
        TacTip(flicker=flicker)


class _Carriage:
    """A replacement of a stage with a given position."""

    def __init__(self) -> None:
        self.at: Point = (0.0, 0.0, 0.0)

    def position(self) -> Point:
        return self.at


PRINTED = PrintedBlock(block=Block.of(2), printer="form-3", filament="grey-v4")
FRAME = WorkFrame(origin_mm=(50.0, 60.0, -20.0), quarter_turns=1)


def test_the_simulated_gauge_follows_the_stage() -> None:
    carriage = _Carriage()
    with SimulatedGauge(carriage.position, FAST, seed=3) as gauge:
        assert isinstance(gauge, Gauge) and gauge.simulated
        assert abs(gauge.read(0.1).mean_n) < 0.001
        gauge.put(PRINTED, HOLDER, FRAME)
        contact = contact_for(PRINTED, HOLDER)
        carriage.at = FRAME.to_stage(_pressed(contact, 1.9))
        felt = gauge.read(1.0)
        assert felt.samples == 80
        assert felt.mean_n == pytest.approx(1.9, abs=5 * GAUGE_NOISE_N / math.sqrt(80))
        assert felt.spread_n == pytest.approx(GAUGE_NOISE_N, rel=0.4)
        gauge.tare()
        assert gauge.read(1.0).mean_n == pytest.approx(0.0, abs=0.001)


def test_the_simulated_sensor_follows_the_stage() -> None:
    carriage = _Carriage()
    with SimulatedSensor(carriage.position, FAST, {"colour": True, "seed": 5, "flicker": 0.0}) as sensor:
        assert isinstance(sensor, Sensor) and sensor.simulated
        sensor.put(PRINTED, HOLDER, FRAME)
        contact = contact_for(PRINTED, HOLDER)
        pose = _pressed(contact, 1.9)
        carriage.at = FRAME.to_stage(pose)
        frame = sensor.read()
        assert frame.shape == sensor.shape == (480, 640, 3)
        expected = TacTip(flicker=0.0).image(contact, FRAME.to_work(carriage.at), _rng(5))
        assert np.mean(np.abs(frame.astype(int) - expected)) < 0.01
        assert frame_faults(sensor.read(), frame) == ()
        assert sensor.settings["requested"]["colour"] is True and sensor.settings["actual"]["colour"] is True


def test_two_sensors_without_a_seed_never_return_the_same_frame() -> None:
    first, second = (SimulatedSensor(_Carriage().position, FAST).read() for _ in range(2))
    assert first.shape == (480, 640) and not np.array_equal(first, second)


@pytest.mark.parametrize(
    ("options", "message"), [({"exposure": 3}, "exposure"), ({"colour": 1}, "colour"), ({"flicker": 2.0}, "flicker")]
)
def test_an_unknown_setting_of_the_simulated_sensor_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        SimulatedSensor(_Carriage().position, FAST, options)


@pytest.mark.parametrize("wavelength", [4.0, 6.2, 10.0])
def test_a_small_wave_on_a_plate_moves_the_pins_as_the_formula_of_the_skin_says(wavelength: float) -> None:
    sensor, plate = TacTip(), flat_plate()
    amplitude, press = 0.02, (0.0, 0.0, DomeContact(plate).z_for_force(0.0, 0.0, 3.0137))
    wave = np.broadcast_to(amplitude * np.sin(2.0 * math.pi * plate.x_mm / wavelength), plate.z_mm.shape)
    bent = DomeContact(replace(plate, z_mm=plate.z_mm + wave))
    pins = sensor.camera.pixels(sensor.pins(DomeContact(plate), press).tips_mm)
    moved = np.linalg.norm(sensor.camera.pixels(sensor.pins(bent, press).tips_mm) - pins, axis=1)
    # Only pins whose neighbourhood touches the plate.
    moved = moved[np.linalg.norm(20.0 / 17.48 * sensor.rest.tips_mm[:, :2], axis=1) < 5.0]
    expected = amplitude * float(shift_px_per_mm(wavelength))
    assert 0.8 * expected < float(np.max(moved)) < 1.25 * expected
    mapped = pin_shifts_px(wave[:200, :200], plate.cell_mm)
    assert float(np.nanmax(mapped[50:150, 50:150])) == pytest.approx(expected, rel=0.02)
