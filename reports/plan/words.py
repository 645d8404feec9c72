"""Words of the report of a planned session: labels, and notes under tables."""

KINDS = {
    "offsets": "Offset",
    "gains": "Gain",
    "backlash": "Backlash",
    "eccentricity": "Eccentricity",
}
CLOCKS = {
    "estimated": "found from the motion",
    "given": "given",
    "none": "the motion does not show it",
}
PARTS = {
    "pixels": "pixels",
    "calibration": "calibration",
    "registration": "registration",
    "leds": "LED places",
    "clock": "clock",
}
ASSUMED = {
    "focal_px": "Focal length [px]",
    "principal_point_px": "Principal point [px]",
    "camera_rotation_deg": "Right camera against left, each axis [°]",
    "base_position_mm": "Robot base, position, each axis [mm]",
    "base_rotation_deg": "Robot base, rotation, each axis [°]",
    "led_body_mm": "LED body, position, each axis [mm]",
    "led_body_deg": "LED body, rotation, each axis [°]",
    "led_mm": "Each LED in the body, each axis [mm]",
    "led_centre_mm": "Apparent LED centre, each axis [mm]",
}
REASONS = {"gauge": "gauge", "not_supported": "not supported"}
UNITS = {"deg": "°", "percent": "%", "mm": "mm"}


class PlanNotes:
    """Sentences, and notes that stand under tables."""

    SAME_ANALYSIS = (
        "Predicted by the analysis of verify run itself, from the spots that this motion will "
        "show. The run's report will state the same if the session is as assumed and no joint is "
        "at fault."
    )
    OBSTACLES = (
        "The plan does not know obstacles and cables. Bring the arm to the first pose, and try the "
        "motion slowly first."
    )
    EXACT = "Taken as exact, as no uncertainty is stated: {}."
    TO_BE_BUILT = (
        "The rig does not exist yet: the uncertainties of its calibration and registration are "
        "assumed, as listed in the appendix."
    )
    KNOWN = (
        "U: of the mean error. At the flange: what that angle moves at most. Then the parts of U: "
        "pixels and readings average out over the pairs, the others do not. Detectable: the "
        "smallest constant offset that will be detected (false alarm 0.1 %, power 80 %)."
    )
    CONFORMS = (
        "Conforms to: the largest error that will be judged to conform. A dash: undecided, however "
        "small the error."
    )
    POSES = "poses.csv lists every stop in order, with the pace of each leg. plan.csv has the path."
    ASSUMED = "Each parameter by itself; 0 is taken as exact."
    JOINTS = (
        "U: expanded uncertainty of the joint's mean error (k as stated). Largest U: of its error "
        "at any pose (k = 2). Detectable: the smallest constant offset that is detected (false "
        "alarm 0.1 %, power 80 %). Separable: the smallest that can be attributed to this joint "
        "alone. Visible: the share of an offset that was there at registration. The mean weights "
        "every pair alike. The fit behind the detectable offset also estimates the errors of rig "
        "and LEDs from the whole motion, so it may detect less than U."
    )
    SOURCES = (
        "U, k = 2. Improve the largest source first. A longer session makes only the first source "
        "smaller."
    )
    HIDDEN = (
        "Base or LEDs were registered through the robot's own encoders. No motion can show the "
        "part of an offset that such a registration hides."
    )
    KINDS = (
        "U (k = 2): with all requested kinds estimated together. Detectable: the smallest that "
        "will be detected if it is alone. A dash: this motion does not show it."
    )
    SPAN = (
        "Upward: the share of pairs whose last travel was upward. Backlash shows where both "
        "directions occur."
    )
    EXCLUDED = "Each posture counts once, under the first reason that excludes it, in this order."
    GEOMETRY = (
        "U (k = 2) of what verify identify would find with base and LEDs held as "
        "their files state them. No motion can determine a gauge."
    )
