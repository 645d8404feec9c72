"""Everything that a diagnosis tries."""

import numpy as np

import robots
from verify.judgement.faults import Fault
from verify.judgement.faults_common import common_faults
from verify.judgement.faults_geometry import geometry_fault
from verify.judgement.faults_joints import joint_faults
from verify.judgement.faults_links import link_faults
from verify.judgement.model import Model
from verify.rig import Rig


def dictionary(model: Model, arm: robots.Arm | None = None, rig: Rig | None = None) -> list[Fault]:
    """Every fault that this session's motion can show at all.

    Args:
        model: the session.
        arm: gives the links; without one none are tried, and single ones need a DH table.
        rig: says where the cameras stand; without it their skew is not tried.
    """
    faults = [f for j in range(model.joints.shape[1]) for f in joint_faults(model, j)]
    faults += common_faults(model, rig)
    if isinstance(arm, robots.DhArm):
        faults += link_faults(model, arm)
    if arm is not None and arm.dof > 1:
        faults.append(geometry_fault(model, arm))
    return [f for f in faults if f.freedom and np.all(np.linalg.norm(f.columns, axis=0) > 0)]
