"""Compile and load what numba compiles before pictures come, by measuring a few small ones."""

import numpy as np

from verify.core.fiducials import Marker
from verify.core.kernels.linear_algebra import motion_misfits, motion_sizes, rotation_vectors
from verify.core.readings import Readings
from verify.core.records import Image, Sighting, StereoPair
from verify.core.rig import Camera, Rig
from verify.io.video import ffv1_intact
from verify.measurement.chain import Detector, Setup, detect_in_turn, measure
from verify.measurement.sensitivities import prepare_views, spot_derivatives

SIZE = (320, 240)  # px
FOCAL = 400.0  # px
BASELINE = 0.2  # m from camera to camera
DISTANCE = 0.6  # m from cameras to marker
LEDS = np.array([[0.0, 0.0, 0.0], [0.06, 0.0, 0.01], [0.01, 0.05, 0.0], [0.05, 0.06, 0.02]])  # m
CORNER = np.array([-0.03, -0.03, DISTANCE])  # m, of the marker, in the rig
SPOT_SIGMA = 2.2  # px, standard deviation
N_PAIRS, RATE = 4, 30.0
N_READINGS = 20


def warm_up(detector: Detector = detect_in_turn) -> None:
    """Measure a few small pictures of four LEDs; takes a moment, after an installation longer.

    The detector is what will look for spots; in another process too.
    """
    rig, marker = _rig(), _marker()
    pictures = _render(rig.left), _render(rig.right)
    times = (number / RATE for number in range(N_PAIRS))
    pairs = (StereoPair(n, t, t + 1e-3, 0.0, 0.0, *pictures) for n, t in enumerate(times))
    for _ in measure(pairs, Setup(rig, marker, detect=detector)):
        pass
    ffv1_intact(b"")  # what a recording is opened with


def warm_up_comparison() -> None:
    """Compile and load what compares readings with measured poses."""
    t = np.arange(N_READINGS) / RATE
    readings = Readings(t, np.sin(t)[:, None])
    readings.at(t)
    readings.available(t)
    readings.rate(t)
    readings.direction(t)  # by the readings' noise
    readings.interpolation_uncertainty(t)
    rotation_vectors(np.eye(3)[None], np.empty((1, 3)))
    figures, poses = np.ones((1, 2)), np.repeat(np.eye(4)[None], N_READINGS, axis=0)
    motion_sizes(poses[:1], poses[:1], figures)
    known = np.ones((1, 1), dtype=np.bool_)
    motion_misfits(
        np.zeros((1, 2, 1), dtype=np.int64), known, poses, (figures, figures), 1.0, np.empty(1)
    )
    led, none = np.arange(len(LEDS)), np.zeros((len(LEDS), 2))
    spread, still = np.zeros((len(LEDS), 2, 2)), np.zeros(len(LEDS))
    sighting = Sighting(led, none, spread, 0.0, 0.0, still, none, still)
    pose = np.eye(4)
    pose[:3, 3] = CORNER
    views = prepare_views(
        pose, sighting, sighting, np.zeros((2 * len(LEDS), 2, 3)), _rig(), _marker()
    )
    spot_derivatives(views, ("left.fx_px", "body.rx_deg"))


def _rig() -> Rig:
    return Rig(SIZE, _camera(-BASELINE / 2), _camera(BASELINE / 2), np.eye(4))


def _marker() -> Marker:
    return Marker(tuple("ABCD"), LEDS, (None,) * len(LEDS), 0.005)


def _camera(x: float) -> Camera:
    width, height = SIZE
    matrix = np.array([[FOCAL, 0.0, width / 2], [0.0, FOCAL, height / 2], [0.0, 0.0, 1.0]])
    aim = np.arctan2(-x, DISTANCE)
    mount = np.eye(4)
    mount[[0, 0, 2, 2], [0, 2, 0, 2]] = [np.cos(aim), np.sin(aim), -np.sin(aim), np.cos(aim)]
    place, axis = np.array([x, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
    return Camera(matrix, np.full(5, 1e-3), place, axis, 0.0, mount)


def _render(camera: Camera) -> Image:
    """Four Gaussian spots in faint noise."""
    points = np.column_stack([LEDS + CORNER, np.ones(len(LEDS))])
    pixels = camera.project((points @ camera.camera_T_rig(0.0).T)[:, :3])
    column, row = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    light = np.random.default_rng(0).normal(8.0, 1.5, (SIZE[1], SIZE[0]))
    for x, y in pixels.tolist():
        light += 260.0 * np.exp(-((column - x) ** 2 + (row - y) ** 2) / (2 * SPOT_SIGMA**2))
    return np.clip(light, 0, 255).astype(np.uint8)
