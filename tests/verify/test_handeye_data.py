"""Registration and clock on recordings of real arms that other people published."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import robots
from robots.transforms import invert
from tests.verify.motions import track_of
from tests.verify.recorded import require_shared
from verify.calibration.handeye_fit import FittedLoop, fit_hand_eye, fit_streams
from verify.calibration.motion_start import begin
from verify.clock import estimate_clock
from verify.readings import Readings
from verify.records import Array

pytestmark = pytest.mark.shared

# SOURCE.md of handeye_franka_visp: ViSP's published solutions (m; rotation vector, rad)
BASE_T_CAMERA = ((0.95404, -0.05124, 0.47622), (-1.10411, -1.11275, 1.28954))
HAND_T_CAMERA = ((0.05772, -0.03392, -0.04228), (0.00178, 0.00917, 1.58178))
TAG_SIDE, SQUARE = 0.048, 0.0236  # m
INNER = (9, 6)  # corners of the checkerboard
IMAGES = range(1, 9)
SHIFT = 0.35  # s, put into the recording with two clocks


def data(*parts: str) -> Path:
    return require_shared().parent.joinpath("data", *parts)


def pose(place: Array, vector: Array) -> Array:
    whole = np.eye(4)
    whole[:3, :3], whole[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), place
    return whole


def apart(one: Array, other: Array) -> tuple[float, float]:
    """How far two poses lie apart, mm and degrees."""
    turn = Rotation.from_matrix(one[:3, :3].T @ other[:3, :3]).magnitude()
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])) * 1e3, float(np.rad2deg(turn))


def franka(kind: str, corners: Callable[[Array], Array], points: Array) -> tuple[Array, Array]:
    """camera_T_target and base_T_hand of the eight images; each pose of most likely corners."""
    folder = data("handeye_franka_visp", kind)
    text = (folder / "franka_camera.xml").read_text()
    fx, fy, cx, cy = (
        float(re.findall(f"<{k}>(.*?)</{k}>", text)[0]) for k in ("px", "py", "u0", "v0")
    )
    camera = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    seen, read = [], []
    for i in IMAGES:
        image = cv2.imread(str(folder / f"franka_image-{i}.png"), cv2.IMREAD_GRAYSCALE)
        found = corners(image)
        flat = cv2.SOLVEPNP_IPPE
        _, turn, place, _ = cv2.solvePnPGeneric(points, found, camera, None, flags=flat)
        best = cv2.solvePnPRefineLM(points, found, camera, None, turn[0], place[0])
        seen.append(pose(best[1].ravel(), best[0].ravel()))
        numbers = re.findall(r"\[(.*?)\]", (folder / f"franka_pose_rPe_{i}.yaml").read_text())
        read.append(pose(np.array(numbers[:3], float), np.array(numbers[3:], float)))
    return np.array(seen), np.array(read)


def tag_corners(image: Array) -> Array:
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    (corners,), _, _ = cv2.aruco.ArucoDetector(family, settings).detectMarkers(image)
    return np.asarray(corners, dtype=float).reshape(4, 2)


def board_corners(image: Array) -> Array:
    found, corners = cv2.findChessboardCornersSB(image, INNER)
    assert found
    return np.asarray(corners, dtype=float).reshape(-1, 2)


def test_a_tag_on_a_franka_hand_is_registered_as_published() -> None:
    half = TAG_SIDE / 2
    corners = np.array([[-half, half, 0], [half, half, 0], [half, -half, 0], [-half, -half, 0]])
    fitted = fit_hand_eye(*franka("data-eye-to-hand", tag_corners, corners))
    place_mm, turn_deg = apart(invert(fitted.y), pose(*map(np.array, BASE_T_CAMERA)))
    assert place_mm < 3.0
    assert turn_deg < 0.5
    # hand_T_tag, published: (22.04, -5.14, -55.63) mm
    tag_mm = invert(fitted.x)[:3, 3] * 1e3
    assert np.linalg.norm(tag_mm - (22.04, -5.14, -55.63)) < 3.0
    assert fitted.good.all()
    # eight poses, factory intrinsics: residuals as published (1.4 to 4.4 mm), not smaller
    place, turn = residuals(fitted)
    assert 1.4 < place.mean() < 4.4
    assert 0.4 < turn.mean() < 1.2


def test_a_camera_on_a_franka_hand_is_registered_as_published() -> None:
    columns, rows = INNER
    grid = [(SQUARE * i, SQUARE * j, 0.0) for j in range(rows) for i in range(columns)]
    seen, read = franka("data-eye-in-hand", board_corners, np.array(grid))
    # board_T_camera · camera_T_hand = board_T_base · base_T_hand
    fitted = fit_hand_eye(invert(seen), read)
    place_mm, turn_deg = apart(invert(fitted.x), pose(*map(np.array, HAND_T_CAMERA)))
    assert place_mm < 3.0
    assert turn_deg < 0.5
    place, _ = residuals(fitted)
    assert 3.2 < place.mean() < 6.6  # published: 5.41 mm, 3.2 to 6.6


def residuals(fitted: FittedLoop) -> tuple[Array, Array]:
    """Length of each pose's residual, mm and degrees."""
    place, turn = np.split(fitted.residual, 2, axis=1)
    return np.linalg.norm(place, axis=1) * 1e3, np.rad2deg(np.linalg.norm(turn, axis=1))


@dataclass(frozen=True)
class Streams:
    """An arm's poses as readings of an arm that can stand in them, and a camera's, unsynchronised.

    The recording has the arm's poses and not its joints. A UR10 whose base stands where it reaches
    all of them makes joints of them that give the same poses back, so that what takes readings
    can be fed.
    """

    arm: robots.Arm
    t: Array  # (m,), s, the arm's clock
    q: Array  # (m, 6), rad
    seen_t: Array  # (n,), s, the camera's clock
    seen: Array  # (n, 4, 4), target_T_camera

    def readings(self, shift: float) -> Readings:
        """The arm's, its clock set back: `shift` has to be added to get what was recorded."""
        return Readings(self.t - shift, self.q)


def stream(name: str, every: int) -> tuple[Array, Array]:
    stem = "robot_arm_complete_bag_color_and_ir_"
    rows = np.loadtxt(data("handeye_timeoffset_asl", f"{stem}{name}.csv"), delimiter=",")[::every]
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3] = Rotation.from_quat(rows[:, 4:8]).as_matrix()
    poses[:, :3, 3] = rows[:, 1:4]
    return rows[:, 0], poses


@pytest.fixture(scope="module")
def streams() -> Streams:
    t, hand = stream("base_link_sr300_hinge", 2)
    arm = robots.load("ur10")
    middle = len(hand) // 2
    comfortable = np.array([0.13, -0.92, 1.65, -0.08, 1.78, -0.60])  # rad
    wanted = robots.forward(arm, comfortable) @ invert(hand[middle]) @ hand
    q = np.zeros((len(hand), 6))
    for way in (range(middle, len(hand)), range(middle, -1, -1)):
        near = comfortable
        for i in way:
            near, reached = robots.nearest(arm, wanted[i], near)
            assert reached
            q[i] = near
    np.testing.assert_allclose(robots.forward(arm, q), wanted, atol=1e-8)
    assert np.abs(np.diff(q, axis=0)).max() < 0.1  # one branch throughout
    return Streams(arm, t, q, *stream("target_ir", 6))


@dataclass(frozen=True)
class Registered:
    """What the streams gave, which of the camera's poses had a reading, and the readings."""

    fitted: FittedLoop
    known: Array  # (k,), int
    readings: Readings


def register(streams: Streams, shift: float) -> Registered:
    readings = streams.readings(shift)
    start = begin(streams.seen_t, streams.seen, streams.arm, readings, None)
    known = np.flatnonzero(readings.known(streams.seen_t - start.clock))

    def hand(t: Array) -> Array:
        return robots.forward(streams.arm, readings.at(t))

    fitted = fit_streams(streams.seen_t[known], streams.seen[known], hand, start.clock)
    return Registered(fitted, known, readings)


@pytest.fixture(scope="module")
def plain(streams: Streams) -> Registered:
    return register(streams, 0.0)


@pytest.fixture(scope="module")
def shifted(streams: Streams) -> Registered:
    return register(streams, SHIFT)


def test_a_camera_on_an_unsynchronised_arm_is_registered_as_noted(plain: Registered) -> None:
    fitted = plain.fitted
    # SOURCE.md: the camera in the mount, by A X = Y B with another solver
    noted_mm = np.array([-15.0, 2.0, 11.0])
    assert np.linalg.norm(fitted.x[:3, 3] * 1e3 - noted_mm) < 10.0
    assert abs(fitted.offset) < 0.02  # as delivered: 0 ± 0.02 s
    place, turn = residuals(fitted)
    assert np.median(place) == pytest.approx(6.9, abs=0.3)
    assert np.median(turn) == pytest.approx(0.44, abs=0.03)


def test_a_shift_of_the_clock_comes_back(plain: Registered, shifted: Registered) -> None:
    assert shifted.fitted.offset - plain.fitted.offset == pytest.approx(SHIFT, abs=0.005)


@pytest.mark.parametrize("which", ["plain", "shifted"])
def test_the_clock_of_a_session_is_found_in_real_poses(
    streams: Streams, which: str, request: pytest.FixtureRequest
) -> None:
    """By what `verify run` calls, from the registered poses alone."""
    found: Registered = request.getfixturevalue(which)
    fitted = found.fitted
    poses = invert(fitted.y) @ streams.seen[found.known] @ fitted.x
    track = track_of(streams.seen_t[found.known], poses, fitted.place, fitted.turn)
    clock = estimate_clock(track, streams.arm, found.readings)
    assert clock.source == "estimated"
    shift = SHIFT if which == "shifted" else 0.0
    as_delivered = request.getfixturevalue("plain").fitted.offset
    assert clock.offset - as_delivered == pytest.approx(shift, abs=0.005)


def test_other_pictures_find_the_same_clock(streams: Streams, plain: Registered) -> None:
    """Half of the pictures against the others: within three of the stated uncertainties."""
    halves = []
    for which in range(2):
        t, seen = streams.seen_t[which::2], streams.seen[which::2]
        half = Streams(streams.arm, streams.t, streams.q, t, seen)
        halves.append(register(half, 0.0).fitted)
    one, other = halves
    u = [h.offset_standard_uncertainty or np.nan for h in halves]
    assert abs(one.offset - other.offset) < 3 * np.hypot(*u)
    assert abs(one.offset - plain.fitted.offset) < 0.005
