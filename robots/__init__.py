"""What a robot arm is: its table or URDF, its limits, where its flange is, and the way back.

    arm = robots.load("iust_6r")
    base_T_flange = robots.forward(arm, q)
    branches = robots.inverse(arm, base_T_flange)

Metres and radians; `base_T_flange` carries flange coordinates to the base. The joint angles q are
the robot file's own: DH θ = sign · q + offset.

Why there are two RV-3SDs. The grasping paper holds two different arms. Its Table 1 and Eqs 18-19
put the 135 mm elbow offset on one side of the forearm; its geometric inverse, Eqs 22-28, needs it
on the other. `rv_3sd` is the table as printed, its limits taken literally as limits of θ (135° at
joint 2 points into the floor). `rv_3sd_melfa` is the arm that the inverse solves and whose printed
limits make mechanical sense; its angles are those the controller shows, J2 = θ2 + 90° and
J3 = θ3 + 90°. Use the second for a real machine; the signs of J4 to J6 and the zero of J6 cannot be
checked from the paper.

Adding an arm of a known family is one TOML file; any other arm can be a URDF. Where its axes are
those of a known family, `inverse` has a closed form for it too.
"""

from robots.arm import Arm, DhArm, UrdfArm
from robots.check import Reach, SelfCheck, reach, self_check
from robots.coupling import Coupling, coupled, couplings
from robots.errors import RobotError
from robots.export import export_urdf
from robots.inverse import Branches, inverse, turns, within_limits
from robots.kinematics import forward, forward_and_jacobian, jacobian, link_frames
from robots.library import example_names, load, names
from robots.nearest import nearest
from robots.pinocchio_model import pinocchio_model

__all__ = [
    "Arm",
    "Branches",
    "Coupling",
    "DhArm",
    "Reach",
    "RobotError",
    "SelfCheck",
    "UrdfArm",
    "coupled",
    "couplings",
    "example_names",
    "export_urdf",
    "forward",
    "forward_and_jacobian",
    "inverse",
    "jacobian",
    "link_frames",
    "load",
    "names",
    "nearest",
    "pinocchio_model",
    "reach",
    "self_check",
    "turns",
    "within_limits",
]
