"""The corrected arm as a robot file that `robots.load` reads, with where it comes from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import Rotation

import robots
from verify.calibration.kinematics.chain import KinematicChain, link_transforms, turn_z
from verify.core.records import Array
from verify.errors import one_line
from verify.io.toml import encode, encode_numbers

N_DIGITS = 12  # digits: a picometre, or 1e-12 rad


@dataclass(frozen=True, slots=True)
class CorrectionProvenance:
    """Where a correction comes from."""

    sentences: Sequence[str]
    inputs: Mapping[str, str]  # files that were read, with their hashes

    def lines(self) -> list[str]:
        """All of it, a line each."""
        return [*self.sentences, *(f"{path}: {digest}" for path, digest in self.inputs.items())]


def encode_robot(
    arm: robots.Arm, chain: KinematicChain, provenance: CorrectionProvenance, *, offsets_only: bool
) -> tuple[str, bytes]:
    """Write the corrected arm: its file's name and content.

    A DH table of which only the offsets changed, no length and no twist, stays a table with its
    closed form. Any other correction leaves the family of arms that have one, so the arm becomes a
    URDF.
    """
    name = f"{arm.name}_identified"
    if offsets_only and isinstance(arm, robots.DhArm):
        return f"{name}.toml", _table(arm, name, chain, provenance)
    return f"{name}.urdf", _urdf(arm, name, chain, provenance)


def _table(
    arm: robots.DhArm, name: str, chain: KinematicChain, provenance: CorrectionProvenance
) -> bytes:
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
    comments = "".join(f"# {one_line(line)}\n" for line in provenance.lines())
    return comments.encode() + encode(
        {
            "format": 1,
            "name": name,
            "family": arm.family,
            "description": f"{arm.description}; joint offsets identified",
            "source": " ".join([arm.source, *provenance.sentences]),
            "joint": joints,
        }
    )


def _urdf(
    arm: robots.Arm, name: str, chain: KinematicChain, provenance: CorrectionProvenance
) -> bytes:
    """One link a joint; a joint's origin holds the link before it and the angle at reading 0."""
    steps = link_transforms(chain)
    names = tuple(f"joint_{j + 1}" for j in range(arm.dof))
    if isinstance(arm, robots.UrdfArm):
        names = arm.joint_names
    links = ["base_link", *(f"link_{j + 1}" for j in range(arm.dof)), "tool0"]
    lines = ['<?xml version="1.0" encoding="utf-8"?>']
    lines += [f"<!-- {_comment(sentence)} -->" for sentence in provenance.lines()]
    lines.append(f"<robot name={quoteattr(name)}>")
    lines += [f'  <link name="{link}"/>' for link in links]
    before, zero = chain.base_T_first, chain.theta(np.zeros(arm.dof))
    for j in range(arm.dof):
        speed = 0.0 if arm.speed is None else float(arm.speed[j])
        span = f'lower="{_number(arm.lower[j])}" upper="{_number(arm.upper[j])}"'
        limits = f'{span} effort="0" velocity="{_number(speed)}"'
        lines += [
            f'  <joint name={quoteattr(names[j])} type="revolute">',
            f'    <parent link="{links[j]}"/>',
            f'    <child link="{links[j + 1]}"/>',
            f"    {_origin(before @ turn_z(float(zero[j])))}",
            f'    <axis xyz="0 0 {chain.sign[j]:g}"/>',
            f"    <limit {limits}/>",
            *(
                f'    <linkage joint={quoteattr(names[k])} factor="{factor}"/>'
                for k, factor in _linkage(chain, j).items()
            ),
            "  </joint>",
        ]
        before = steps[j]
    lines += [
        '  <joint name="flange" type="fixed">',
        f'    <parent link="{links[-2]}"/>',
        '    <child link="tool0"/>',
        f"    {_origin(before @ chain.last_T_flange)}",
        "  </joint>",
        "</robot>",
    ]
    return ("\n".join(lines) + "\n").encode()


def _linkage(chain: KinematicChain, joint: int) -> dict[int, int]:
    """How often an axis turns with each joint before it."""
    row = [] if chain.linkage is None else chain.linkage[joint, :joint].astype(int).tolist()
    return {k: factor for k, factor in enumerate(row) if factor}


def _origin(pose: Array) -> str:
    """URDF's roll, pitch, yaw turn about the fixed x, y, z axes, in this order."""
    turn = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz")
    place = " ".join(_number(v) for v in pose[:3, 3])
    return f'<origin xyz="{place}" rpy="{" ".join(_number(v) for v in turn)}"/>'


def _number(value: float) -> str:
    return f"{float(value):.{N_DIGITS}g}"


def _comment(sentence: str) -> str:
    """XML allows no two hyphens inside a comment, and none at its end."""
    return one_line(sentence).replace("--", "- -").rstrip("-")
