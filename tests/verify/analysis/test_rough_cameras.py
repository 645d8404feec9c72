"""Cameras that are known to a pixel: what they do to poses is told beyond first order."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.command import SAMPLES
from verify.analysis.session import analyse
from verify.core.rig import Covariance
from verify.io.session.session import Session, open_session

CENTRES = ("left.cx_px", "left.cy_px", "right.cx_px", "right.cy_px")
OFFSET = {"multi_joint_fault_6r": 0.35, "multi_joint_rv_3sd": 0.0}  # deg, of joint 2


def with_rough_centres(session: Session, seed: int, sigma: float) -> Session:
    """The session with optical centres that are off by so many px, and stated as such."""
    off = np.random.default_rng(seed).normal(0, sigma, (2, 2))
    matrices = [camera.matrix.copy() for camera in (session.rig.left, session.rig.right)]
    for matrix, by in zip(matrices, off, strict=True):
        matrix[:2, 2] += by
    left = replace(session.rig.left, matrix=matrices[0])
    right = replace(session.rig.right, matrix=matrices[1])
    stated = Covariance(CENTRES, np.full(4, sigma), np.eye(4))
    return replace(session, rig=replace(session.rig, left=left, right=right, covariance=stated))


@pytest.mark.parametrize("sample", OFFSET)
@pytest.mark.parametrize(
    ("seed", "sigma"), [(3, 1.0), (14, 1.0), (17, 1.0), (21, 1.0), (8, 2.0), (10, 2.0)]
)
def test_optical_centres_known_to_a_pixel_accuse_no_joint(
    sample: str, seed: int, sigma: float
) -> None:
    """A pixel moves a pose by some mm, of which second order is ten times what the LEDs tell."""
    session = open_session(SAMPLES / sample)
    sound = analyse(session).summary
    summary = analyse(with_rough_centres(session, seed, sigma)).summary
    assert summary["pairs"]["measured"] >= sound["pairs"]["measured"] - 1  # its spots disagree
    assert summary["verdict"] == sound["verdict"]
    known = [c["joint"] for c in summary["diagnosis"] if c["kind"] != "ambiguous"]
    assert known == [2] * (sample == "multi_joint_fault_6r")
    for one, other in zip(summary["joints"], sound["joints"], strict=True):
        off = abs(one["mean_error_deg"] - other["mean_error_deg"])
        assert off < one["expanded_uncertainty_deg"] + other["expanded_uncertainty_deg"]
        true = OFFSET[sample] * (one["joint"] == 2)
        assert abs(one["mean_error_deg"] - true) < 1.5 * one["expanded_uncertainty_deg"]


@pytest.mark.parametrize("sample", OFFSET)
@pytest.mark.parametrize("seed", [1, 2, 3, 5, 11, 13])
def test_images_that_disagree_as_the_rig_states_are_measured(sample: str, seed: int) -> None:
    """Of two optical centres that are known to 2 px one point's images lie up to 6 px apart."""
    session = open_session(SAMPLES / sample)
    summary = analyse(with_rough_centres(session, seed, 2.0)).summary
    assert summary["pairs"]["measured"] > 0.85 * len(session)
    assert [c["joint"] for c in summary["diagnosis"] if c["joint"]] in ([], [2])
    for joint in summary["joints"]:
        true = OFFSET[sample] * (joint["joint"] == 2)
        assert abs(joint["mean_error_deg"] - true) < 1.5 * joint["expanded_uncertainty_deg"]
