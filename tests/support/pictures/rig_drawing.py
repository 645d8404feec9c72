"""The set-up as a picture: arm, LEDs, both cameras on their bases, to scale from a session."""

from io import BytesIO
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import proj3d
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection

from robots.kinematics import link_frames
from robots.transforms import invert
from verify import Session
from verify.core.records import Array
from verify.core.rig import Camera

SIZE_IN, PIXELS_PER_INCH = (8.0, 4.9), 110
VIEW_DEG = (20.0, -103.0)  # elevation and azimuth: the arm on the left, the cameras on the right
LIGHT = np.array([0.35, -0.75, 0.56])
ARM, JOINT, CAMERA, BASE, BRACKET = "#c9d1d6", "#7d8b94", "#3b4248", "#a9b2b8", "#e0a458"
LINK_RADIUS, JOINT_RADIUS = 0.036, 0.05  # m, as drawn: the table has no shapes
MIN_LENGTH = 1e-3  # m: shorter ones are not drawn
SIDES = 24  # of a round body
LABEL = {"fontsize": 9.5, "color": "#1d2327"}


class Drawing:
    """Solids in the robot's base frame, m, drawn far ones first."""

    def __init__(self) -> None:
        self.faces: list[Array] = []
        self.colours: list[Array] = []

    def tube(self, begin: Array, end: Array, radius: float, colour: str) -> None:
        """A closed cylinder from one point to another."""
        along = (end - begin) / np.linalg.norm(end - begin)
        across = np.cross(along, [1.0, 0, 0] if abs(along[0]) < 0.9 else [0, 1.0, 0])
        across /= np.linalg.norm(across)
        turn = np.linspace(0, 2 * np.pi, SIDES, endpoint=False)[:, None]
        rim = radius * (np.cos(turn) * across + np.sin(turn) * np.cross(along, across))
        low, high = begin + rim, end + rim
        for i in range(SIDES):
            j = (i + 1) % SIDES
            self._face(np.array([low[i], low[j], high[j], high[i]]), rim[i] + rim[j], colour)
        self._face(low, -along, colour)
        self._face(high, along, colour)

    def box(self, place: Array, size: tuple[float, float, float], colour: str) -> None:
        """A box about the origin of a frame, (4, 4); sizes along its axes, m."""
        half = np.array(size) / 2
        for axis in range(3):
            for sign in (-1.0, 1.0):
                u, v = (axis + 1) % 3, (axis + 2) % 3
                corners = np.zeros((4, 3))
                corners[:, axis] = sign * half[axis]
                corners[:, u] = half[u] * np.array([-1, 1, 1, -1])
                corners[:, v] = half[v] * np.array([-1, -1, 1, 1])
                self._face(corners @ place[:3, :3].T + place[:3, 3], sign * place[:3, axis], colour)

    def _face(self, corners: Array, normal: Array, colour: str) -> None:
        bright = 0.66 + 0.34 * max(0.0, float(normal @ LIGHT) / float(np.linalg.norm(normal)))
        rgb = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        self.faces.append(corners)
        self.colours.append(np.minimum(bright * rgb * 1.08, 1.0))


def rig_drawing(session: Session) -> bytes:
    """Draw a session's set-up at its first reading, PNG."""
    figure = Figure(figsize=SIZE_IN, dpi=PIXELS_PER_INCH)
    axes = figure.add_axes((0.0, -0.02, 1.0, 1.0), projection="3d", computed_zorder=False)
    base_T_rig = invert(session.rig.rig_T_base)
    frames = link_frames(session.arm, session.encoders.q[:1])[0]
    leds = session.marker.leds @ frames[-1][:3, :3].T + frames[-1][:3, 3]
    drawing = Drawing()
    _arm(drawing, frames, leds)
    cameras = [
        _camera(drawing, base_T_rig, camera, pan)
        for camera, pan in (
            (session.rig.left, session.frames.pan_left[0]),
            (session.rig.right, session.frames.pan_right[0]),
        )
    ]
    pivots = [_pivot(base_T_rig, camera) for camera in (session.rig.left, session.rig.right)]
    _stand(drawing, pivots, _down(base_T_rig, session.rig.left))
    rays = [[place[:3, 3], led] for place in cameras for led in leds]
    colours = {"facecolors": drawing.colours, "edgecolors": drawing.colours}
    solids = Poly3DCollection(drawing.faces, lw=0.3, zorder=2, **colours)
    axes.add_collection3d(solids, autolim=False)
    axes.add_collection3d(
        Line3DCollection(rays, colors="#d0462f", lw=0.7, alpha=0.55, zorder=3), autolim=False
    )
    axes.plot(*leds.T, "o", ms=5, color="#fff3c4", mec="#d0462f", mew=1.2, zorder=5)
    _frame(axes, np.vstack(drawing.faces))
    _labels(axes, frames, leds, cameras)
    buffer = BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def _arm(drawing: Drawing, frames: Array, leds: Array) -> None:
    """Links from joint to joint, a drum about each joint's axis, the bracket with the LEDs."""
    drawing.tube(np.array([0, 0, -0.07]), np.array([0, 0, -0.02]), 0.1, JOINT)
    for frame, after in pairwise(frames):
        begin, end, axis = frame[:3, 3], after[:3, 3], frame[:3, 2]
        elbow = begin + axis * ((end - begin) @ axis)  # along the joint, then along the link
        for a, b in ((begin, elbow), (elbow, end)):
            if np.linalg.norm(b - a) > MIN_LENGTH:
                drawing.tube(a, b, LINK_RADIUS, ARM)
        drawing.tube(begin - 0.055 * axis, begin + 0.055 * axis, JOINT_RADIUS, JOINT)
    flange = frames[-1]
    drawing.tube(flange[:3, 3] - 0.012 * flange[:3, 2], flange[:3, 3], 0.045, JOINT)
    for led in leds:
        foot = led - flange[:3, 2] * ((led - flange[:3, 3]) @ flange[:3, 2])
        drawing.tube(flange[:3, 3], foot, 0.006, BRACKET)
        drawing.tube(foot, led, 0.006, BRACKET)


def _camera(drawing: Drawing, base_T_rig: Array, camera: Camera, pan: float) -> Array:
    """A camera, its lens, and the turning base under it; its place in the base frame, (4, 4)."""
    place = base_T_rig @ camera.rig_T_camera(pan)
    pivot, down = _pivot(base_T_rig, camera), _down(base_T_rig, camera)
    body = place.copy()
    body[:3, 3] -= 0.035 * place[:3, 2]
    drawing.box(body, (0.058, 0.042, 0.06), CAMERA)
    centre, ahead = place[:3, 3], place[:3, 2]
    drawing.tube(centre - 0.006 * ahead, centre + 0.02 * ahead, 0.017, CAMERA)
    drawing.tube(pivot + 0.021 * down, pivot + 0.05 * down, 0.04, JOINT)
    drawing.tube(pivot + 0.05 * down, pivot + 0.075 * down, 0.052, BASE)
    return place


def _pivot(base_T_rig: Array, camera: Camera) -> Array:
    return base_T_rig[:3, :3] @ camera.pan_center + base_T_rig[:3, 3]


def _down(base_T_rig: Array, camera: Camera) -> Array:
    axis = base_T_rig[:3, :3] @ camera.pan_axis
    return -axis if axis[2] > 0 else axis


def _stand(drawing: Drawing, pivots: list[Array], down: Array) -> None:
    """The bar that carries both bases, and its stand on the floor."""
    left, right = (pivot + 0.083 * down for pivot in pivots)
    along = (right - left) / np.linalg.norm(right - left)
    bar = np.eye(4)
    bar[:3, :3] = np.stack([along, np.cross(down, along), down], axis=1)
    bar[:3, 3] = (left + right) / 2
    length = float(np.linalg.norm(right - left))
    drawing.box(bar, (length + 0.13, 0.05, 0.016), BASE)
    foot = bar[:3, 3] * [1, 1, 0]
    drawing.tube(bar[:3, 3], foot, 0.018, BASE)
    drawing.tube(foot, foot + np.array([0, 0, 0.015]), 0.13, BASE)


def _frame(axes: Any, points: Array) -> None:
    """Show the points whole, all axes to one scale, and nothing of the axes."""
    low, high = points.min(axis=0), points.max(axis=0)
    for name, a, b in zip("xyz", low, high, strict=True):
        getattr(axes, f"set_{name}lim")(a, b)
    axes.set_box_aspect(high - low, zoom=1.2)
    axes.view_init(*VIEW_DEG)
    axes.set_axis_off()


def _labels(axes: Any, frames: Array, leds: Array, cameras: list[Array]) -> None:
    left, right = (place[:3, 3] for place in cameras)
    middle = leds.mean(axis=0)
    texts = [
        (frames[0][:3, 3] + [0, 0, 0.03], "robot base", (-70, -6)),
        (frames[2][:3, 3], "arm, its encoders\nread all the while", (-130, 20)),
        (middle, f"{len(leds)} LEDs on\nthe flange", (-44, 58)),
        (left, "left camera", (66, 20)),
        (right, "right camera", (-58, 22)),
        (left - [0, 0, 0.07], "turning base,\nor a fixed mount", (62, -38)),
    ]
    for point, text, offset in texts:
        x, y, _ = proj3d.proj_transform(*point, axes.get_proj())
        axes.annotate(
            text, (x, y), xytext=offset, textcoords="offset points", ha="center", va="center",
            arrowprops={"arrowstyle": "-", "lw": 0.8, "color": "#59656d", "shrinkB": 2}, zorder=9,
            **LABEL,
        )  # fmt: skip
    apart = np.linalg.norm(left - right) * 1e3
    away = np.linalg.norm((left + right) / 2 - middle) * 1e3
    axes.text2D(
        0.5, 0.02, f"cameras {apart:.0f} mm apart, {away:.0f} mm from the LEDs; places to scale",
        transform=axes.figure.transFigure, ha="center", fontsize=8.5, color="#59656d",
    )  # fmt: skip
