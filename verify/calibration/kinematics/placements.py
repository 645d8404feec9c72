"""Where base and target were found, and the files in which `verify run` takes them.

A session of pictures gets a rig.toml and a marker.toml, to be put in the place of its own; one of
poses a whole folder, with the corrected arm. Both say source = "motion": through the encoders.
"""

import tomllib
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from verify.calibration.kinematics.chain import AXES
from verify.calibration.kinematics.fit import KinematicFit
from verify.calibration.kinematics.sessions import CombinedPoses
from verify.calibration.origin import DEG, MM, POSE_UNITS
from verify.calibration.registration.uncertainty import BASE_NAMES
from verify.calibration.stereo.records import extend_covariance
from verify.core.fiducials import Marker
from verify.core.records import POSE_NAMES, Array
from verify.core.rig import Rig
from verify.io import rig as io_rig
from verify.io.fiducials import encode_marker
from verify.io.session.session import Session
from verify.io.toml import encode, encode_numbers, parse


def placement_entries(fit: KinematicFit) -> list[dict[str, Any]]:
    """Every base and target that was fitted: its pose, and its standard uncertainties."""
    return [
        {
            "kind": kind,
            "number": place + 1,
            "position_mm": (pose[:3, 3] * MM).tolist(),
            "rotation_vector_deg": Rotation.from_matrix(pose[:3, :3]).as_rotvec(True).tolist(),
            "standard_uncertainty": dict(zip(POSE_NAMES, sigma.tolist(), strict=True)),
        }
        for kind, poses in (("base", fit.state.base), ("tool", fit.state.tool))
        for place, pose in enumerate(poses)
        if (sigma := placement_uncertainty(fit, kind, place)).any()
    ]


def session_files(
    gathered: CombinedPoses, fit: KinematicFit, robot_file: str, robot: bytes
) -> Iterator[tuple[str, bytes]]:
    """Paths and contents of what `verify run` takes; nothing where base and target were held.

    The fit is the chosen model's, `robot` the content of the corrected arm's file.
    """
    kinds = {p.kind for p in fit.parameters if p.axis}
    for i, one in enumerate(gathered.sessions):
        row = int(np.argmax(gathered.source == i))
        base, tool = int(gathered.poses.base[row]), int(gathered.poses.tool[row])
        session, instrument = one.session, one.session.instrument
        if not kinds or (instrument is not None and instrument.poses.of_several):
            continue
        rig = moved_rig(session.rig, fit, base) if "base" in kinds else session.rig
        folder = f"sessions/{session.name}"
        if instrument is None:
            yield f"{folder}/rig.toml", io_rig.encode(rig)
            yield f"{folder}/{robot_file}", robot
            if "tool" in kinds:
                yield f"{folder}/marker.toml", encode_marker(_moved_marker(session, fit, tool))
            continue
        text = registered_session(session, fit, rig, tool, robot_file, stated=gathered.poses.stated)
        yield f"{folder}/session.toml", text
        yield f"{folder}/{robot_file}", robot
        for path in session.inputs:
            if path.endswith(".csv"):
                yield f"{folder}/{path}", (session.folder / path).read_bytes()


def placement_uncertainty(fit: KinematicFit, kind: str, place: int) -> Array:
    """Standard uncertainties of a base or a tool, (6,), mm and degrees; 0 where it was held."""
    return np.asarray(np.sqrt(np.diag(_covariance(fit, kind, place))) * POSE_UNITS)


def target_in_flange(session: Session, fit: KinematicFit, place: int = 0) -> Array:
    """Pose of a session's target in the flange frame, (4, 4), m."""
    tool, instrument = fit.state.tool[place], session.instrument
    posed = instrument is not None and not instrument.positions_alone
    return np.asarray(tool @ instrument.flange_T_body if instrument and posed else tool)


def _covariance(fit: KinematicFit, kind: str, place: int) -> Array:
    """Of a base's or tool's six numbers, (6, 6), m and rad; 0 where they were held."""
    found = np.zeros((6, 6))
    own = [k for k, p in enumerate(fit.parameters) if (p.kind, p.place) == (kind, place)]
    axes = [AXES.index(fit.parameters[k].axis) for k in own]
    found[np.ix_(axes, axes)] = fit.covariance[np.ix_(own, own)]
    return found


def moved_rig(rig: Rig, fit: KinematicFit, place: int) -> Rig:
    """The rig with the robot where it was found: the rows are in the base as the rig had it."""
    moved = rig.rig_T_base @ fit.state.base[place]
    turn = block_diag(moved[:3, :3], moved[:3, :3])
    own = turn @ _covariance(fit, "base", place) @ turn.T
    known, across = rig.covariance, np.zeros((6, 0))
    if known is not None:
        kept = [i for i, n in enumerate(known.parameters) if n not in BASE_NAMES]
        known, across = known.take(kept), np.zeros((6, len(kept)))
    covariance = extend_covariance(known, BASE_NAMES, across, own)
    return replace(
        rig, rig_T_base=moved, base_source="motion", registration=None, absorption=None,
        covariance=covariance,
    )  # fmt: skip


def _without_cameras(rig: Rig) -> Rig:
    """The rig with what is stated of its robot's base alone, as a session of poses has it."""
    known = rig.covariance
    names = known.parameters if known is not None else ()
    own = [i for i, name in enumerate(names) if name.startswith("robot_base.")]
    if known is None or not own:
        return replace(rig, covariance=None)
    found = replace(known.take(own), degrees_of_freedom=None, temperature_c=None)
    return replace(rig, covariance=found)


def _moved_marker(session: Session, fit: KinematicFit, place: int) -> Marker:
    """The LEDs where the flange has them: a session's LEDs are its target."""
    tool, marker = fit.state.tool[place], session.marker
    u = np.sqrt(np.diag(_covariance(fit, "tool", place)))
    leds = marker.leds @ tool[:3, :3].T + tool[:3, 3]
    return replace(
        marker, leds=leds, source="motion", registration=None, body_standard_uncertainty=u
    )


def registered_session(
    session: Session,
    fit: KinematicFit,
    rig: Rig,
    place: int = 0,
    robot_file: str | None = None,
    *,
    stated: bool,
) -> bytes:
    """The session.toml of poses with base and target where they were found.

    `place` numbers the target; `robot_file` names the corrected arm, None leaves the arm as it is.
    """
    tree = parse(session.folder / "session.toml")
    if robot_file is not None:
        tree.pop("robot_frames", None)
        tree["robot"] = robot_file
    body, instrument = target_in_flange(session, fit, place), session.instrument
    assert instrument is not None
    point_mm = encode_numbers(body[:3, 3], 1 / MM)
    poses = {**tree["poses"], "point_mm": point_mm, "frame": "instrument"}
    if not instrument.positions_alone:
        poses["rotation"] = encode_numbers(body[:3, :3])
    if not stated:
        poses["position_standard_uncertainty_mm"] = fit.scale.position * MM
        if not instrument.positions_alone:
            poses["orientation_standard_uncertainty_deg"] = fit.scale.orientation * DEG
    sigma = placement_uncertainty(fit, "tool", place).tolist()
    if any(sigma):
        uncertainty = dict(zip(POSE_NAMES, sigma, strict=True))
        poses |= {"source": "motion", "body_standard_uncertainty": uncertainty}
    whole = tomllib.loads(io_rig.encode(_without_cameras(rig)).decode())
    tree |= {"poses": poses, "robot_base": whole["robot_base"]}
    tree.pop("rig", None)
    tree["covariance"] = whole.get("covariance")
    return encode(tree)
