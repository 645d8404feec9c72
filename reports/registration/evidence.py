"""Residuals of a registration, and joint axes against the DH table: figures, tables, notes."""

from functools import partial
from typing import Any

import numpy as np

from reports.calibration.figures import CAMERAS, residual_vectors
from reports.calibration.words import FIGURES as CALIBRATION
from reports.document import blocks as doc
from reports.document import charts
from reports.document.formatting import count, finite, number, percent, significant
from reports.results import Results


def visible_shares(results: Results) -> charts.Chart | None:
    """Share of a constant offset of each joint that can still be seen."""
    joints = results.summary.get("joints") or []
    shares = [finite(joint.get("visible_fraction")) for joint in joints]
    if not any(share is not None for share in shares):
        return None
    places = np.arange(len(joints), dtype=float)
    heights = np.array([100 * share if share is not None else 0.0 for share in shares])
    marks: list[charts.Mark] = [charts.Bars(places, heights, np.zeros(len(joints)), "used", "")]
    marks += [
        charts.Note(float(at), float(height) + 2.0, percent(share))
        for at, height, share in zip(places, heights, shares, strict=True)
    ]
    ticks = tuple(
        (float(at), f"joint {j.get('joint')}") for at, j in zip(places, joints, strict=True)
    )
    panel = charts.Panel(
        tuple(marks), "visible [%]", x_ticks=ticks, x_range=(-0.6, len(joints) - 0.4),
        y_range=(0.0, 112.0), unit="%",
    )  # fmt: skip
    return charts.Chart((panel,), row_height=1.8, width=0.7)


def residuals_over_time(results: Results) -> charts.Chart | None:
    """Residuals of each pair, either camera."""
    table = results.table("residuals")
    frames, dx, dy = (charts.column(table, n) for n in ("frame", "residual_x_px", "residual_y_px"))
    valid = np.isfinite(frames + dx + dy)
    if "used" in table:
        valid &= table["used"].to_numpy(dtype=bool)
    if not valid.any():
        return None
    cameras = np.array(charts.texts(table, "camera"))
    panels = []
    for camera, role in CAMERAS:
        own = valid & (cameras == camera)
        pairs = np.unique(frames[own])
        squares = dx**2 + dy**2
        rms = np.array([np.sqrt(np.mean(squares[own & (frames == f)])) for f in pairs])
        panels.append(
            charts.Panel(
                (charts.Line(*charts.trace(pairs, rms), role, f"{camera} camera"),),
                "rms [px]",
                "pair" if camera == "right" else "",
                x_ticks=charts.count_ticks(frames[valid]),
                y_range=(0.0, 1.08 * float(rms.max())) if len(rms) else None,
                unit="px",
            )
        )
    return charts.Chart(tuple(panels), row_height=1.1, shared_x=True)


def pose_residuals(results: Results) -> charts.Chart | None:
    """What base and target leave of each pose that an instrument measured."""
    table = results.table("poses")
    number, used = charts.column(table, "pose"), charts.column(table, "used") > 0
    panels = []
    for key, label, unit in (
        ("residual_mm", "position [mm]", "mm"), ("residual_deg", "turn [°]", "°"),
    ):  # fmt: skip
        size = charts.column(table, key)
        own = used & np.isfinite(size)
        if own.any():
            line = charts.Line(*charts.trace(number[own], size[own]), "measured", label)
            top = 1.08 * float(size[own].max())
            ticks = charts.count_ticks(number[used])
            panels.append(
                charts.Panel((line,), label, "pose", y_range=(0.0, top), x_ticks=ticks, unit=unit)
            )
    return charts.Chart(tuple(panels), row_height=1.1, shared_x=True) if panels else None


def fixture_differences(results: Results) -> charts.Chart | None:
    """The board's place in each pair less the common one, mm."""
    table = results.table("pairs")
    frames = charts.column(table, "frame")
    marks = [
        charts.Points(frames, charts.column(table, f"{axis}_mm"), f"series_{at}", axis, 3.0)
        for at, axis in ((1, "x"), (2, "y"), (3, "z"))
    ]
    if not any(np.isfinite(mark.y).any() for mark in marks):
        return None
    panel = charts.Panel(
        (charts.Level(0.0, "muted"), *marks), "less the common place [mm]", "pair",
        x_ticks=charts.count_ticks(frames), unit="mm",
    )  # fmt: skip
    return charts.Chart((panel,), row_height=2.2)


def linearity(results: Results) -> charts.Chart | None:
    """Encoder less turn about the axis, over each swept joint."""
    table = results.table("sweeps")
    joints = charts.column(table, "joint")
    panels = []
    for joint in np.unique(joints[np.isfinite(joints)]).tolist():
        own = joints == joint
        q, error = (
            charts.column(table, "reading_deg")[own],
            charts.column(table, "nonlinearity_deg")[own],
        )
        order = np.argsort(q, kind="stable")
        panels.append(
            charts.Panel(
                (charts.Line(q[order], error[order], "measured"),),
                f"q{joint:.0f} [°]",
                "reading [°]",
                unit="°",
            )
        )
    return charts.Chart(tuple(panels), columns=2, row_height=1.1) if panels else None


METHODS = {
    "motion": "from the robot's own motion, through its own encoders",
    "fixture": "from a board at a known place on the base",
    "poses": "from another instrument's poses, through the robot's own encoders",
    "sweeps": "from sweeps of single joints",
}


class RegistrationNotes:
    """Notes that stand under tables."""

    WORSE = (
        "Pairs that were held out fit clearly worse than those that were registered on: something "
        "moves that is held fixed here, or the motion is too poor. Look at the residuals over time."
    )
    THROUGH = (
        "Stated for encoders without errors of their own; what a constant offset of a joint moves "
        "with it is in the absorption matrix of the registration."
    )
    POSES = (
        "What hides is what base and target took in with the encoders' own errors. A base or a "
        "target that was measured without the robot hides less (--keep-base, --keep-leds). An "
        "offset that arises later shows in full."
    )
    HELD = "Held as it was stated."
    HELD_LEDS = "The LEDs were held as the marker had them."
    NOTHING_HIDDEN = (
        "The robot's encoders took no part in finding its base, so the base hides nothing of their "
        "errors. The registration of LEDs that were found through the encoders says what "
        "they hide."
    )
    NOT_KNOWN = "What the registration hides is not known."
    VISIBLE = (
        "Base and LEDs were fitted to the same encoders, so an offset that was there already moved "
        "them with it; visible is the share of its signal that is left, base moved how far a "
        "degree of it moved the base. One that arises later shows in full in every session that "
        "is measured with this registration."
    )
    HOLD_OUT = "Where both are alike, the registration holds at other poses too."
    FIXTURE = (
        "χ² of six degrees of freedom: above 22.5 once in a thousand by chance. A pair beyond it "
        "indicates that the board or a base moved."
    )
    AXES = "Compared without the registration: cameras alone. False alarm: 0.1 % over all rows."
    GEARS = "1 where the encoder turns as the joint does; it needs neither base nor table."
    NO_SWEEPS = "No joint was swept alone, so the axes were not compared with the table."


FIGURES = {
    "visible": doc.FigurePlan(
        visible_shares,
        "Visible share of a constant offset of each joint that was there at registration.",
        "Bars, one a joint: visible share in percent.",
        "What the registration hides is not known.",
    ),
    "fixture": doc.FigurePlan(
        fixture_differences,
        "The board's place in each pair, less the one that all pairs share.",
        "Points over the pairs: difference in x, y and z in millimetres.",
        "The pairs were not kept.",
    ),
    "over_time": doc.FigurePlan(
        residuals_over_time,
        "RMS residual of each pair's spots. It rises from the pair on at which the registration "
        "stops holding.",
        "Two strips over the pairs: rms residual in pixels, left and right camera.",
        "The residuals were not kept.",
    ),
    "vectors": doc.FigurePlan(
        residual_vectors,
        "Residuals of the spots over the image, magnified as the arrow on top says: thin lines for "
        "spots, arrows for their means over cells.",
        CALIBRATION["vectors"].alt,
        "The residuals were not kept.",
    ),
    "poses": doc.FigurePlan(
        pose_residuals,
        "Residual of each pose, with base and target fitted.",
        "Strips over the poses: residual of the position in millimetres, of the turn in degrees.",
        "The residuals were not kept.",
    ),
    "linearity": doc.FigurePlan(
        linearity,
        "Encoder less turn about the joint's own axis over its sweep, a straight line taken out.",
        "Strips over the reading, one a joint, in degrees.",
        "The sweeps were not kept.",
    ),
}


figure_block = partial(doc.figure_or_text, FIGURES)


def residuals(results: Results) -> doc.Section:
    """Say how well the registration fits, where it was fitted and where it was held out."""
    fit = results.summary.get("fit") or {}
    rows = tuple(
        doc.row(name, number(fit.get(key), 3))
        for name, key in (
            ("All pairs", "rms_px"),
            ("Fitted on one half, judged on it", "fit_rms_px"),
            ("Fitted on one half, judged on the other", "held_out_rms_px"),
        )
        if finite(fit.get(key)) is not None
    )
    held_out = finite(fit.get("held_out_rms_px")) is not None
    notes = (RegistrationNotes.HOLD_OUT,) if held_out else ()
    blocks: list[doc.Block] = []
    seen = "board's corners" if results.summary.get("method") == "fixture" else "spots"
    if rows:
        blocks.append(
            doc.Table(
                f"Reprojection of the {seen}.", "lr", ("Registered on", "rms [px]"), rows, notes
            )
        )
    if finite(fit.get("misfit")) is not None:
        blocks.append(
            doc.Paragraph(
                f"The misfit is {significant(fit['misfit'])} a degree of freedom, where noise "
                "alone gives 1; the stated uncertainties allow for it."
            )
        )
    if len(results.table("poses")):
        blocks.append(figure_block(results, "poses"))
    elif len(results.table("pairs")):
        blocks.append(_fixture_table(results))
    else:
        blocks += [figure_block(results, "over_time"), figure_block(results, "vectors")]
    return doc.Section("residuals", "Residuals", tuple(blocks))


def _fixture_table(results: Results) -> doc.Table:
    columns = [doc.Column("Pair", "r", doc.field("frame", count))]
    columns += [
        doc.Column(f"{a} [mm]", "r", doc.field(f"{a}_mm", number, signed=True)) for a in "xyz"
    ]
    columns += [
        doc.Column(f"r{a} [°]", "r", doc.field(f"r{a}_deg", number, signed=True)) for a in "xyz"
    ]
    columns.append(doc.Column("χ² of 6", "r", doc.field("chi2", number, 1)))
    title = "The board's place in each pair, less the one that all pairs share."
    return doc.tabulate(
        title, columns, charts.records(results.table("pairs")), RegistrationNotes.FIXTURE
    )


_expanded = partial(doc.uncertain_field, signed=False, k=2.0)


def axes(results: Results) -> doc.Section:
    """Compare the axes that one-joint sweeps show with the arm's table."""
    blocks: list[doc.Block] = []
    pairs, gears = results.table("axes"), results.table("gears")
    if len(pairs):
        columns: tuple[doc.Column, ...] = (
            doc.Column("Joints", "c", doc.field("joints")),
            doc.Column("Angle ± U [°]", "r", _expanded("angle_deg", "angle_u_deg")),
            doc.Column("Table [°]", "r", doc.field("angle_table_deg", number, 2)),
            doc.Column("Apart ± U [mm]", "r", _expanded("distance_mm", "distance_u_mm")),
            doc.Column("Table [mm]", "r", doc.field("distance_table_mm", number, 2)),
            doc.Column("Verdict", "l", _axes_verdict),
        )
        title = "Angle and distance between the axes of joints, found and by the table; k = 2."
        blocks.append(doc.tabulate(title, columns, charts.records(pairs), RegistrationNotes.AXES))
    if len(gears):
        columns = (
            doc.Column("Joint", "c", doc.field("joint")),
            doc.Column("Swept [°]", "r", doc.field("span_deg", number, 1)),
            doc.Column("Turn over encoder ± U", "r", _expanded("gear", "gear_u")),
        )
        title = "Turn of each joint about its own axis over its encoder's; k = 2."
        blocks.append(doc.tabulate(title, columns, charts.records(gears), RegistrationNotes.GEARS))
        blocks.append(figure_block(results, "linearity"))
    if not blocks:
        blocks.append(doc.Paragraph(RegistrationNotes.NO_SWEEPS, "note"))
    return doc.Section("axes", "Axes against the table", tuple(blocks))


def _axes_verdict(pair: dict[str, Any]) -> doc.Cell:
    return (
        doc.Cell("agrees", "conform") if pair.get("agrees") else doc.Cell("differs", "nonconform")
    )
