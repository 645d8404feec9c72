"""What a registration rests on, in its report: residuals, and axes against the table."""

from reports.blocks import (
    Block,
    Cell,
    Figure,
    Paragraph,
    Section,
    Table,
    drawn_or_said,
    row,
)
from reports.formatting import (
    count,
    finite,
    measured,
    number,
    significant,
    word,
)
from reports.registration_figures import REGISTRATION_FIGURES
from reports.registration_words import FIGURES, Words
from reports.results import Results


def drawn(results: Results, name: str) -> Block:
    """Show one of the report's figures, or say why it is not there."""
    said = FIGURES[name]
    drawing = REGISTRATION_FIGURES[name](results)
    return drawn_or_said(Figure(name, said.caption, said.alt), drawing, said.otherwise)


def residuals(results: Results) -> Section:
    """Say how well the registration fits, where it was fitted and where it was held out."""
    fit = results.summary.get("fit") or {}
    rows = [
        row(name, number(fit.get(key), 3))
        for name, key in (
            ("All pairs", "rms_px"),
            ("Fitted on one half, judged on it", "fit_rms_px"),
            ("Fitted on one half, judged on the other", "held_out_rms_px"),
        )
        if finite(fit.get(key)) is not None
    ]
    blocks: list[Block] = []
    if rows:
        blocks.append(
            Table("Reprojection of the spots.", "lr", ("Registered on", "rms [px]"), tuple(rows),
                  (Words.HOLD_OUT,) if finite(fit.get("held_out_rms_px")) is not None else ())
        )  # fmt: skip
    if finite(fit.get("misfit")) is not None:
        blocks.append(
            Paragraph(
                f"The misfit is {significant(fit['misfit'])} a degree of freedom, where noise "
                "alone gives 1; the stated uncertainties allow for it."
            )
        )
    if len(results.table("pairs")):
        blocks.append(_fixture_table(results))
    else:
        blocks += [drawn(results, "over_time"), drawn(results, "vectors")]
    return Section("residuals", "Residuals", tuple(blocks))


def _fixture_table(results: Results) -> Table:
    units = ("x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg")
    rows = tuple(
        row(
            count(pair["frame"]),
            *(number(pair.get(name), 3, signed=True) for name in units),
            number(pair.get("chi2"), 1),
        )
        for pair in results.table("pairs").to_dict("records")
    )
    return Table(
        "The board's place in each pair, less the one that all pairs share.",
        "rrrrrrrr",
        ("Pair", "x [mm]", "y [mm]", "z [mm]", "rx [°]", "ry [°]", "rz [°]", "χ² of 6"),
        rows,
        (Words.FIXTURE,),
    )


def axes(results: Results) -> Section:
    """Compare the axes that one-joint sweeps show with the arm's table."""
    blocks: list[Block] = []
    pairs, gears = results.table("axes"), results.table("gears")
    if len(pairs):
        rows = tuple(
            row(
                word(pair.get("joints")),
                measured(pair.get("angle_deg"), pair.get("angle_u_deg"), signed=False),
                number(pair.get("angle_table_deg"), 2),
                measured(pair.get("distance_mm"), pair.get("distance_u_mm"), signed=False),
                number(pair.get("distance_table_mm"), 2),
                Cell("agrees", "conform") if pair.get("agrees") else Cell("differs", "nonconform"),
            )
            for pair in pairs.to_dict("records")
        )
        blocks.append(
            Table(
                "Angle and distance between the axes of joints, found and by the table.",
                "crrrrl",
                ("Joints", "Angle ± u [°]", "Table [°]", "Apart ± u [mm]", "Table [mm]", "Verdict"),
                rows,
                (Words.AXES,),
            )
        )  # fmt: skip
    if len(gears):
        rows = tuple(
            row(
                word(gear.get("joint")),
                number(gear.get("span_deg"), 1),
                measured(gear.get("gear"), gear.get("gear_u"), signed=False),
            )
            for gear in gears.to_dict("records")
        )
        head = ("Joint", "Swept [°]", "Turn over encoder ± u")
        title = "Turn of each joint about its own axis over its encoder's."
        blocks += [Table(title, "crr", head, rows, (Words.GEARS,)), drawn(results, "linearity")]
    if not blocks:
        blocks.append(Paragraph(Words.NO_SWEEPS, "note"))
    return Section("axes", "Axes against the table", tuple(blocks))
