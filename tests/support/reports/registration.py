"""Registrations made by hand."""

import numpy as np
import pandas as pd

from reports.results import Results


def motion() -> Results:
    """Joints 1 and 6 hidden, one swept joint."""
    random = np.random.default_rng(4)
    rows = [
        {"frame": f, "camera": camera, "led": "A", "x_px": 400 + 8.0 * f, "y_px": 300.0 + f,
         "residual_x_px": random.normal(0, 0.1), "residual_y_px": random.normal(0, 0.1),
         "used": f != 7}
        for f in range(40) for camera in ("left", "right")
    ]  # fmt: skip
    q = np.linspace(-20, 20, 30)
    three = [0.1, 0.2, 0.3]
    summary = {
        "kind": "registration", "method": "motion", "robot": "iust_6r",
        "source": {"path": "session"}, "registration": "sha256:" + "5c" * 32,
        "pairs": {"used": 40, "left_out": {"too few LEDs told apart": 2}},
        "base": {"position_mm": [91.0, 662.0, 1181.0], "standard_uncertainty_mm": three,
                 "rotation_vector_deg": [44.9, 104.7, -93.5], "standard_uncertainty_deg": three,
                 "held": False},
        "leds": [{"name": "A", "x_mm": 61.8, "y_mm": 3.1, "z_mm": 18.0,
                  "u_x_mm": 0.13, "u_y_mm": 0.1, "u_z_mm": None}],
        "leds_held": False,
        "clock": {"offset_s": 0.1372, "standard_uncertainty_s": 0.0002},
        "skew": {"offset_s": 0.0, "standard_uncertainty_s": None},
        "joints": [{"joint": j + 1, "visible_fraction": v}
                   for j, v in enumerate([0.0, 0.04, 0.09, 0.5, 0.95, 0.0])],
        "fit": {"rms_px": 0.14, "fit_rms_px": 0.13, "held_out_rms_px": 0.15, "misfit": 1.2},
        "decisions": ["4 LEDs move together."], "warnings": [],
    }  # fmt: skip
    axes = pd.DataFrame(
        [{"joints": "1 and 2", "angle_deg": 90.1, "angle_table_deg": 90.0, "angle_u_deg": 0.1,
          "distance_mm": 40.3, "distance_table_mm": 40.0, "distance_u_mm": 0.4, "agrees": True},
         {"joints": "2 and 3", "angle_deg": 0.5, "angle_table_deg": 0.0, "angle_u_deg": 0.1,
          "distance_mm": 250.0, "distance_table_mm": 250.0, "distance_u_mm": 0.3, "agrees": False}]
    )  # fmt: skip
    gears = pd.DataFrame([{"joint": 2, "span_deg": 40.0, "gear": 1.001, "gear_u": 0.0004}])
    sweeps = pd.DataFrame(
        {"joint": 2, "frame": range(30), "reading_deg": q, "nonlinearity_deg": 0.01 * np.sin(q)}
    )
    tables = {"residuals": pd.DataFrame(rows), "axes": axes, "gears": gears, "sweeps": sweeps}
    return Results(summary, {"image_size_px": [1280, 720]}, tables)


def fixture() -> Results:
    """A board on the base: nothing is hidden."""
    given = motion()
    pairs = pd.DataFrame(
        [{"frame": f, "x_mm": 0.01, "y_mm": 0.0, "z_mm": -0.02, "rx_deg": 0.001, "ry_deg": 0.0,
          "rz_deg": 0.0, "chi2": 5.2} for f in range(4)]
    )  # fmt: skip
    keep = {k: given.summary[k] for k in ("kind", "robot", "source", "base", "registration")}
    summary = {**keep, "method": "fixture", "pairs": {"used": 4}, "fit": {"rms_px": 0.05}}
    return Results(summary, given.setup, {"pairs": pairs})
