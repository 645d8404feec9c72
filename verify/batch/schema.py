"""The columns of sessions.parquet and frames.parquet, with their types; docs/batch.md has words.

Both have as many columns a joint as the fleet's longest arm has joints; of a shorter arm the rest
is null. What is unknown is null.
"""

import pyarrow as pa

STATUSES = (
    "too_few_leds",
    "ambiguous_leds",
    "no_encoder",
    "unreachable",
    "outlier",
    "unaligned",
)
FLANGE = (("position", "mm"), ("orientation", "deg"))
NUMBER, TEXT, COUNT = pa.float64(), pa.string(), pa.int64()

JOINT = (
    ("mean_error_deg", NUMBER),
    ("rms_error_deg", NUMBER),
    ("max_abs_error_deg", NUMBER),
    ("standard_uncertainty_deg", NUMBER),
    ("expanded_uncertainty_deg", NUMBER),
    ("coverage_factor", NUMBER),
    ("session_uncertainty_deg", NUMBER),
    ("worst_error_deg", NUMBER),
    ("worst_error_standard_uncertainty_deg", NUMBER),
    ("tolerance_deg", NUMBER),
    ("conformance_probability", NUMBER),
    ("verdict", TEXT),
    ("reason", TEXT),
    ("pairs", COUNT),
    ("visible_fraction", NUMBER),
    ("visible_fraction_since_registration", NUMBER),
    ("minimum_detectable_error_deg", NUMBER),
    ("minimum_separable_error_deg", NUMBER),
)
CAUSE = pa.struct(
    [
        ("joint", COUNT),
        ("kind", TEXT),
        ("value", NUMBER),
        ("unit", TEXT),
        ("standard_uncertainty", NUMBER),
        ("expanded_uncertainty", NUMBER),
        ("explains", NUMBER),
        ("candidates", pa.list_(pa.struct([("joint", COUNT), ("kind", TEXT)]))),
        ("parameter", TEXT),
        ("per_turn", COUNT),
        ("phase_deg", NUMBER),
        ("turn_deg", NUMBER),
        ("separating_motion", TEXT),
    ]
)
FRAME = (
    ("frame", COUNT),
    ("t_s", NUMBER),
    ("status", TEXT),
    ("leds_seen", COUNT),
    ("known_dof", COUNT),
    ("reprojection_rms_px", NUMBER),
    *((f"{axis}_mm", NUMBER) for axis in "xyz"),
    *((f"r{axis}_deg", NUMBER) for axis in "xyz"),
    *((f"{axis}_encoder_mm", NUMBER) for axis in "xyz"),
    *((f"r{axis}_encoder_deg", NUMBER) for axis in "xyz"),
)
FRAME_JOINT = ("measured_deg", "encoder_deg", "error_deg", "u_deg", "error_u_deg")


def sessions(joints: int) -> pa.Schema:
    """Give the columns of sessions.parquet for a fleet whose longest arm has so many joints."""
    flange = [
        column
        for name, unit in FLANGE
        for column in (
            (f"{name}_rms_error_{unit}", NUMBER),
            (f"{name}_max_error_{unit}", NUMBER),
            (f"{name}_expanded_uncertainty_{unit}", NUMBER),
            (f"{name}_worst_error_{unit}", NUMBER),
            (f"{name}_worst_error_standard_uncertainty_{unit}", NUMBER),
            (f"{name}_tolerance_{unit}", NUMBER),
            (f"{name}_conformance_probability", NUMBER),
            (f"{name}_verdict", TEXT),
            (f"{name}_reason", TEXT),
        )
    ]
    return pa.schema(
        [
            ("session", TEXT),
            ("robot", TEXT),
            ("description", TEXT),
            ("started", pa.timestamp("us", tz="UTC")),
            ("kept_in", TEXT),
            ("tool_version", TEXT),
            ("calibration", TEXT),
            ("base_source", TEXT),
            ("registration", TEXT),
            ("robot_fingerprint", TEXT),
            ("joints", COUNT),
            ("pairs_recorded", COUNT),
            ("pairs_measured", COUNT),
            *((f"rejected_{status}", COUNT) for status in STATUSES),
            ("clock_encoder_offset_s", NUMBER),
            ("clock_standard_uncertainty_s", NUMBER),
            ("clock_source", TEXT),
            ("clock_observable", pa.bool_()),
            ("verdict", TEXT),
            ("decision_rule", TEXT),
            *((f"q{j + 1}_{name}", kind) for j in range(joints) for name, kind in JOINT),
            ("joint_error_correlation", pa.list_(NUMBER)),
            *flange,
            ("diagnosis", pa.list_(CAUSE)),
            ("uncounted", pa.list_(TEXT)),
            ("inputs", pa.list_(pa.struct([("file", TEXT), ("digest", TEXT)]))),
            ("warnings", pa.list_(TEXT)),
            ("known_dof", COUNT),
        ]
    )


def frames(joints: int) -> pa.Schema:
    """Give the columns of frames.parquet likewise."""
    return pa.schema(
        [
            ("session", TEXT),
            *FRAME,
            *((f"q{j + 1}_{name}", NUMBER) for name in FRAME_JOINT for j in range(joints)),
            ("position_error_mm", NUMBER),
            ("orientation_error_deg", NUMBER),
            ("ambiguous_joints", TEXT),
        ]
    )
