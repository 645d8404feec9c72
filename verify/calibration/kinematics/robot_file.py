"""The corrected arm as a robot file that `robots.load` reads, with where it comes from."""

from collections.abc import Mapping, Sequence

import numpy as np

import robots
from robots.export import WrittenJoint, urdf_text
from robots.transforms import turn_z
from verify.calibration.kinematics.chain import KinematicChain, link_transforms
from verify.errors import one_line
from verify.io.toml import encode, encode_numbers


def encode_robot(
    arm: robots.Arm,
    chain: KinematicChain,
    sentences: Sequence[str],
    inputs: Mapping[str, str],
    *,
    offsets_only: bool,
) -> tuple[str, bytes]:
    """Write the corrected arm: its file's name and content.

    The sentences say where the correction comes from, the inputs which files were read, with their
    hashes.

    A DH table of which only the offsets changed, no length and no twist, stays a table with its
    closed form. Any other correction leaves the family of arms that have one, so the arm becomes a
    URDF.
    """
    name = f"{arm.name}_identified"
    comments = [*sentences, *(f"{path}: {digest}" for path, digest in sorted(inputs.items()))]
    if offsets_only and isinstance(arm, robots.DhArm):
        lead = "".join(f"# {one_line(line)}\n" for line in comments)
        return f"{name}.toml", lead.encode() + _table(arm, name, chain, sentences)
    return f"{name}.urdf", _urdf(arm, name, chain, comments)


def _table(arm: robots.DhArm, name: str, chain: KinematicChain, sentences: Sequence[str]) -> bytes:
    columns = {
        "a_mm": arm.a * 1e3,
        "d_mm": arm.d * 1e3,
        "alpha_deg": np.degrees(arm.alpha),
        "offset_deg": np.degrees(chain.theta(np.zeros(arm.dof))),
        "sign": arm.sign,
        "limits_deg": np.degrees(np.stack([arm.lower, arm.upper], axis=1)),
    }
    for key, rate in (
        ("speed_deg_s", arm.speed),
        ("acceleration_deg_s2", arm.acceleration),
        ("jerk_deg_s3", arm.jerk),
    ):
        if rate is not None:
            columns[key] = np.degrees(rate)
    joints = [
        {
            key: encode_numbers(column[j] if column.ndim > 1 else float(column[j]))
            for key, column in columns.items()
        }
        | ({"linkage": {f"q{k + 1}": f for k, f in linked.items()}} if linked else {})
        for j in range(arm.dof)
        for linked in [_linkage(chain, j)]
    ]
    return encode(
        {
            "format": 1,
            "name": name,
            "family": arm.family,
            "description": f"{arm.description}; joint offsets identified",
            "source": " ".join([arm.source, *sentences]),
            "joint": joints,
        }
    )


def _urdf(arm: robots.Arm, name: str, chain: KinematicChain, comments: Sequence[str]) -> bytes:
    """A joint's origin holds the link before it and the angle at reading 0."""
    steps = link_transforms(chain)
    names = tuple(f"joint_{j + 1}" for j in range(arm.dof))
    if isinstance(arm, robots.UrdfArm):
        names = arm.joint_names
    joints, before, zero = [], chain.base_T_first, chain.theta(np.zeros(arm.dof))
    for j in range(arm.dof):
        joints.append(
            WrittenJoint(
                names[j],
                before @ turn_z(float(zero[j])),
                float(chain.sign[j]),
                float(arm.lower[j]),
                float(arm.upper[j]),
                0.0 if arm.speed is None else float(arm.speed[j]),
                {names[k]: factor for k, factor in _linkage(chain, j).items()},
            )
        )
        before = steps[j]
    return urdf_text(name, joints, before @ chain.last_T_flange, comments).encode()


def _linkage(chain: KinematicChain, joint: int) -> dict[int, int]:
    """How often an axis turns with each joint before it."""
    row = [] if chain.linkage is None else chain.linkage[joint, :joint].astype(int).tolist()
    return {k: factor for k, factor in enumerate(row) if factor}
