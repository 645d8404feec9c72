"""A chain of six axes as a DH table of a family with a closed form.

Each family's twists say which axes are parallel and which square. The common normals of the axes
give the table, whatever links and frames a file has between them; fixed motions before and behind
carry the file's base and flange. A chain is read from its base or from its flange, and one of seven
joints with the last of them given. A file that rounds its angles (1.5708 for a right angle) misses
the family by 4e-6 rad: its answers are then brought to the file's own chain by Newton steps.
What was found is proved before it counts: random postures must be among the inverse's answers.
"""

from dataclasses import replace

import numpy as np

from robots import intersecting_axes, offset_wrist, parallel_axes, spherical_wrist
from robots.arm import DhArm, TableForm, UrdfArm
from robots.closed_form import Needed
from robots.inverse import FAMILIES, form_pose, inverse, near
from robots.kinematics import forward, jacobian
from robots.transforms import Array, difference

# deviations of a file's axes from a family's: of angles written to five digits, and over 1 m
MAX_TILT = 1e-4  # rad
MAX_OFFSET = 1e-4  # m
TOL_EXACT = 1e-12  # m and rad: a table that differs by less is the file's own chain
MAX_ERROR = 1e-9  # m and rad, of an answer's pose
MAX_JOINT_DIFFERENCE = 1e-6  # rad, of an answer from the posture that made the pose
MIN_REGULAR = 1e-2  # least singular value of J over its greatest: below, a posture proves nothing
N_POSTURES = 40  # random, of a proof

SHAPES: dict[str, tuple[tuple[float, ...], Needed]] = {  # twists, deg, and lengths of each family
    "parallel_axes": (parallel_axes.ALPHA, parallel_axes.LENGTHS),
    "spherical_wrist": (spherical_wrist.ALPHA_BY_SIDE[1], spherical_wrist.LENGTHS),
    "intersecting_axes": (intersecting_axes.ALPHA, intersecting_axes.LENGTHS),
    "offset_wrist": (offset_wrist.ALPHA, offset_wrist.LENGTHS),
}


def recognise(arm: UrdfArm) -> TableForm | None:
    """Find the closed form of a chain of six or seven joints; None where no family has it."""
    if arm.dof not in (6, 7):
        return None
    axes, points = arm.rest_frames[:6, :3, 2], arm.rest_frames[:6, :3, 3]
    for reverse in (False, True):
        for family in SHAPES:
            ordered = (-axes[::-1], points[::-1]) if reverse else (axes, points)
            form = _table(*ordered, family, reverse=reverse)
            proved = form and _proved(arm, form)
            if proved:
                return proved
    return None


def _table(axes: Array, points: Array, family: str, *, reverse: bool) -> TableForm | None:
    """The DH table of axes (6, 3) through points (6, 3), m, in the base, if the family has it.

    Frame 0 is where axis 1 meets its normal to axis 2, with x along that; frame 6 is frame 5.
    """
    twists, lengths = SHAPES[family]
    z, sign = axes.copy(), np.ones(6)
    columns = np.zeros((3, 6))  # a, d, offset
    frames = np.tile(np.eye(4), (6, 1, 1))  # 0 to 5
    at, x = points[0], None
    for i, twist in enumerate(twists[:5]):
        if twist == 0 and z[i] @ z[i + 1] < 0:
            z[i + 1], sign[i + 1] = -z[i + 1], -1.0
        normal = _normal(z[i], z[i + 1], points[i + 1] - at, twist)
        if normal is None:
            return None
        along, a, d = normal
        if x is None:
            x, at, d = along, at + d * z[0], 0.0
            frames[0, :3] = np.column_stack([x, np.cross(z[0], x), z[0], at])
        columns[:, i] = a, d, np.arctan2(np.cross(x, along) @ z[i], x @ along)
        x, at = along, at + d * z[i] + a * along
    needed = np.array(
        [[np.nan if v is None else v / 1e3 for v in column] for column in lengths.values()]
    )
    if (np.abs(columns[:2] - needed) > MAX_OFFSET).any():  # never of NaN
        return None
    columns[:2] = np.where(np.isnan(needed), columns[:2], needed)
    unlimited = np.full(6, np.inf)
    table = DhArm(
        name=family, description="", source="", fingerprint="", lower=-unlimited, upper=unlimited,
        a=columns[0], d=columns[1], alpha=np.radians(twists), sign=sign, offset=columns[2],
        family=family,
    )  # fmt: skip
    misfit = offset_wrist.misfit if family == "offset_wrist" else FAMILIES[family].misfit
    if misfit(table):
        return None
    return TableForm(table, frames[0], frames[0] @ forward(table, np.zeros(6)), reverse)


def _normal(
    z: Array, z_next: Array, between: Array, twist: float
) -> tuple[Array, float, float] | None:
    """The unit normal of two axes by whose turn of `twist`, deg, the one becomes the other.

    Then, m, how far apart they are by it, and how far along z it begins. `between` leads from a
    point of the first axis to one of the second. None where they are not so turned, or are one.
    """
    across = np.cross(z, z_next)
    begin = float(between @ z)
    if twist:
        normal = np.sign(twist) * across / max(float(np.linalg.norm(across)), MAX_TILT)
        return (normal, float(between @ normal), begin) if abs(z @ z_next) < MAX_TILT else None
    apart = between - begin * z
    distance = float(np.linalg.norm(apart))
    if np.linalg.norm(across) > MAX_TILT or distance < MAX_OFFSET:
        return None
    return apart / distance, distance, 0.0


def _proved(arm: UrdfArm, form: TableForm) -> TableForm | None:
    """The form, marked exact or not, if random postures are among its answers; else None."""
    plain = replace(arm.unlinked, closed_form=form)
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (N_POSTURES, arm.dof))
    pose = forward(plain, q)
    apart = np.abs(difference(form_pose(plain, q), pose)).max()
    plain = replace(plain, closed_form=replace(form, exact=bool(apart < TOL_EXACT)))
    found = inverse(plain, pose, hold=q).q
    exists = np.isfinite(found[..., 0])
    targets = np.broadcast_to(pose[:, None], (*exists.shape, 4, 4))[exists]
    reached = np.abs(difference(forward(plain, found[exists]), targets)).max(initial=0) < MAX_ERROR
    values = np.linalg.svd(jacobian(plain, q)[..., :6], compute_uv=False)
    regular = values[:, -1] > MIN_REGULAR * values[:, 0]
    away = np.abs(near(found, q[:, None]) - q[:, None]).max(axis=-1)
    contained = (away < MAX_JOINT_DIFFERENCE).any(axis=-1)
    return plain.closed_form if reached and contained[regular].all() and regular.any() else None
