"""The report of a calibration, in words: parameters, figures, notes."""

from reports.calibration import figures
from reports.document.blocks import FigurePlan

GROUPS = {
    "focal lengths": "the cameras' focal lengths",
    "principal points": "the principal points",
    "lens distortion": "the lens distortion",
    "cameras' turns": "the cameras' relative orientation",
    "cameras' places": "the cameras' relative position",
    "pan axes and zeros": "the turning bases' axes and zeros",
    "pan readings": "the pan readings",
    "spot noise": "the noise of the LED spots, not the rig",
}

PARAMETERS = {
    "fx_px": "Focal length fx [px]",
    "fy_px": "Focal length fy [px]",
    "cx_px": "Principal point cx [px]",
    "cy_px": "Principal point cy [px]",
    "k1": "Radial distortion k1",
    "k2": "Radial distortion k2",
    "p1": "Tangential distortion p1",
    "p2": "Tangential distortion p2",
    "k3": "Radial distortion k3",
    "pan_zero_deg": "Pan zero [°]",
    **{f"pan_center_{a}_mm": f"Pan centre {a} [mm]" for a in "xyz"},
    **{f"pan_axis_r{a}_deg": f"Pan axis, turn about {a} [°]" for a in "xyz"},
    **{f"mount_r{a}_deg": f"Mount, rotation vector {a} [°]" for a in "xyz"},
    **{f"mount_{a}_mm": f"Mount {a} [mm]" for a in "xyz"},
}


class CalibrationNotes:
    """Notes that stand under tables."""

    CHOSEN = (
        "Chosen: no picture of a board determines it. It sets where the rig's frame lies, or, with "
        "a base that never turned, how the camera's place is shared between pan centre, axis and "
        "mount. Pan axes are given by the turn that carries the rig's y axis to them."
    )
    TURNING = (
        "The bases were turned between pairs: their axes, centres and zeros and the mounts were "
        "found from the boards as well. The relation holds at the median of the pan readings."
    )
    STILL = (
        "The bases stood still, so the pictures do not determine turning axes, pan centres and "
        "mounts: they were chosen, and the calibration holds at these pan readings only."
    )
    PAIRS = (
        "A positive tilt brings the upper edge (horizontal axis) or the right edge (vertical axis) "
        "nearer. Behind the corners, in brackets: how many were rejected. A view stands out if its "
        "rms lies 3.5 robust standard deviations and half above the median of its camera's views."
    )
    COVERED = (
        "The boards cover both images, near and far, and were tilted about both axes either way: "
        "nothing is missing."
    )
    POINT = (
        "Noise: one spot, both images, once; it averages out. Rig: the calibration's own "
        "uncertainty, all correlations included; it does not. Across: in the direction across the "
        "line of sight in which it is largest. A part of the rig's share shifts or turns the whole "
        "field alike; the registration of a robot with the same rig compensates that part."
    )
    LENGTH = (
        "A shift or turn of the whole field does not change a length: only errors of the rig's "
        "scale and shape count here."
    )
    GROUPS = (
        "The parts do not add up, because parameters found from the same pictures are correlated: "
        "errors of one compensate those of another. The last column shows where more or better "
        "pictures help."
    )


FIGURES = {
    "views": FigurePlan(
        figures.view_errors,
        "Reprojection error of each view: root mean square distance of the corners from where the "
        "calibration puts them.",
        "Bars, two a pair: rms residual in pixels in the left and the right camera.",
        "No view was kept.",
    ),
    "vectors": FigurePlan(
        figures.residual_vectors,
        "Residuals over the image, magnified as the arrow on top says: thin lines for corners, "
        "arrows for their means over cells. Single lines are noise; neighbouring arrows that point "
        "one way are lens distortion that the model does not follow.",
        "Two pictures of arrows, left and right camera.",
        "The residuals were not kept.",
    ),
    "coverage": FigurePlan(
        figures.coverage,
        "Number of corners seen in each part of either image. Where there are none, the lens is "
        "known by extrapolation only.",
        "Two grids over the images with the number of corners in each cell.",
        "The coverage of the images is not known.",
    ),
    "stances": FigurePlan(
        figures.board_poses,
        "Poses of the boards. Left: tilt about the vertical and about the horizontal axis; focal "
        "lengths and principal points need boards well off the middle, on all sides. Right: "
        "distance, and total tilt.",
        "Two scatter plots, a point a board: tilts in degrees, and distance in millimetres.",
        "The poses of the boards are not known.",
    ),
    "scene": FigurePlan(
        figures.scene,
        "Boards and cameras in space, from the middle between the cameras.",
        "Outlines of the boards in space before two pyramids that stand for the cameras.",
        "The places of the boards are not known.",
    ),
    "rectified": FigurePlan(
        None,
        "One pair after rectification: the same corner lies on the same level line in both "
        "pictures.",
        "Left and right picture side by side with level lines across both.",
        "No pair was given to show rectified.",
    ),
    "accuracy": FigurePlan(
        figures.accuracy,
        "Expected uncertainty (U, k = 2, in mm) of an LED's place over the field that both "
        "cameras see, a row a distance: left from the noise of one spot, right from the rig. An "
        "empty cell is out of sight.",
        "Grids of numbers over the field in millimetres, two at each of several distances.",
        "The expected accuracy is not known.",
    ),
    "contributions": FigurePlan(
        figures.contributions,
        "Uncertainty of the depth (U, k = 2) at the working distance without one source. The "
        "lowest bar shows what to improve first; the dotted line is the present uncertainty.",
        "Bars, one a source, and a line for the present uncertainty, in millimetres.",
        "The uncertainty was not broken down.",
    ),
    "parameter_correlation": FigurePlan(
        figures.correlation,
        "Correlation of the rig's parameters, from −1 (blue) over 0 (pale) to +1 (orange). Strong "
        "colour off the diagonal: the pictures determine a combination better than either "
        "parameter.",
        "A square matrix of coloured cells, one row and one column a parameter.",
        "The correlation of the parameters is not known.",
    ),
}
