"""The same arm in pinocchio, from its table: for cross-checks and for whatever pinocchio can do."""

from typing import TYPE_CHECKING

import numpy as np

from robots.arm import Arm, DhArm, UrdfArm

if TYPE_CHECKING:
    import pinocchio

Z = np.array([0.0, 0.0, 1.0])


def pinocchio_model(arm: Arm) -> "pinocchio.Model":
    """Build the arm in pinocchio; its last frame is called "flange".

    Its configuration is q, of a linked arm `axis_angles` of q. A URDF's model is the one it was
    loaded into, with its own frame names.
    """
    if isinstance(arm, UrdfArm):
        return arm.model
    import pinocchio

    assert isinstance(arm, DhArm)
    model = pinocchio.Model()
    model.name = arm.name
    parent, placement = 0, pinocchio.SE3.Identity()
    for i in range(arm.dof):
        axis = arm.sign[i] * Z  # RotZ(sign · q) is a turn about ±z
        zero = pinocchio.SE3(pinocchio.utils.rotate("z", arm.offset[i]), np.zeros(3))
        joint = pinocchio.JointModelRevoluteUnaligned(axis)
        parent = model.addJoint(parent, joint, placement * zero, f"joint_{i + 1}")
        model.lowerPositionLimit[i], model.upperPositionLimit[i] = arm.lower[i], arm.upper[i]
        twist = pinocchio.utils.rotate("x", arm.alpha[i])
        placement = pinocchio.SE3(twist, np.array([arm.a[i], 0.0, arm.d[i]]))
    kind = pinocchio.FrameType.OP_FRAME
    model.addFrame(pinocchio.Frame("flange", parent, placement, kind))
    return model
