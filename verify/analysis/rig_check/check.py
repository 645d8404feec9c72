"""Does the rig still see as it did when it was calibrated? From a rigid body of known shape.

Three figures show it, and none asks where the body stands, so no encoder and no robot enters:
how much longer than known the body's lengths are measured (scale), by how many pixels the right
image lies below where the left one says (vertical; the epipolar disagreement), and how far it is
turned against it (roll). A camera that was bumped shifts at least one of them; a turn of both
cameras together shifts none.

They are fitted in the images, by generalised least squares on what the fit of the body's pose
left over; every source of error is carried into them, the pixels' noise, which averages out, and
what does not: the rig's stated covariance, LED positions, apparent centres, pan readings.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from verify.analysis.least_squares import autocorrelation
from verify.analysis.rig_check.pair import PairEquations, invert_shown, rows_of
from verify.core.fiducials import Marker
from verify.core.records import Array, Index, Measurement
from verify.core.rig import Rig
from verify.core.statistics import MAD_TO_SIGMA
from verify.measurement.pose import MODEL_ERROR_PX
from verify.measurement.systematics import PAN_READINGS, Systematics, pixel_sensitivities

# ratio: measured length over known, less 1; px, right image below left; rad, right image turned
# clockwise about the body's image
FIGURES = ("scale", "vertical", "roll")
FALSE_ALARM_Z = 3.59  # two-sided 0.1 % over the three figures: 0.033 % each
MAX_PAIRS = 300  # evenly spread: what does not average out rules long before; more cost time
MAX_DEVIATION = 5.0  # robust standard deviations: a reflection in one pair is not the rig's doing

# Changes of the rig whose effect on the figures is reported: name, parameters of rig.toml that
# make it up with their weights, unit in which it is told.
CHANGES = {
    "yaw of one camera": ({"right.mount_ry_deg": 1.0}, "deg"),
    "pitch of one camera": ({"right.mount_rx_deg": 1.0}, "deg"),
    "roll of one camera": ({"right.mount_rz_deg": 1.0}, "deg"),
    "baseline": ({"left.pan_center_x_mm": -0.5, "right.pan_center_x_mm": 0.5}, "mm"),
    "focal length of both cameras": (
        {f"{side}.f{axis}_px": 1.0 for side in ("left", "right") for axis in "xy"},
        "px",
    ),
    "principal point of one camera, across": ({"right.cx_px": 1.0}, "px"),
    "principal point of one camera, down": ({"right.cy_px": 1.0}, "px"),
}


@dataclass(frozen=True, slots=True)
class RigConsistency:
    """The three figures over a session, and all that is behind their uncertainty."""

    value: Array  # (3,), see FIGURES
    random: Array  # (3, 3), what averages out, autocorrelation included
    systematic: Array  # (3, 3), what does not
    by_source: dict[str, Array]  # (3,) standard uncertainty of each figure from each source
    by_change: dict[str, Array]  # (3,) change of each figure, a m, rad or px of each of CHANGES
    focal_length: float  # px, of the right camera, upright: what carries vertical into space
    frame: Index  # (n,), pairs that were used
    series: Array  # (n, 3), the figures of single pairs; nan where a pair does not show one
    left_out: tuple[int, ...]  # frames that contradict all others

    @property
    def uncertainty(self) -> Array:
        """Combined standard uncertainty of each figure, (3,)."""
        return np.sqrt(np.diag(self.random + self.systematic))

    @property
    def per_metre(self) -> Array:
        """What carries the figures into one unit, mm per metre, (3,).

        Of a known length; of the distance; of the distance from the middle of the picture.
        """
        return 1e3 * np.array([1.0, 1.0 / self.focal_length, 1.0])

    @property
    def z(self) -> Array:
        """Each figure in its standard uncertainty, (3,)."""
        return self.value / self.uncertainty


def consistency(
    measurements: Sequence[Measurement], rig: Rig, marker: Marker, parameters: Systematics
) -> RigConsistency | None:
    """Fit the figures over measured pairs; `parameters` as `stated_systematics` collects them.

    Of a pair that no pose explains (status `outlier`: in a bumped rig that may be all of them)
    every spot counts, else those that the fit kept. Where the robot stands is not used. None where
    no pair shows the figures: a single LED, or no LED in both images.
    """
    posed = [m for m in measurements if m.pose is not None]
    spread = np.linspace(0, len(posed) - 1, min(len(posed), MAX_PAIRS)).astype(int)
    rows = rows_of([posed[i] for i in spread], marker)
    rows, left_out = _reject_outliers(rows)
    if not rows:
        return None
    information = np.sum([r.information for r in rows], axis=0)
    inverse = invert_shown(information)
    wanted = np.sum([r.wanted for r in rows], axis=0)
    value = np.where(np.diag(information) > 0, inverse @ wanted, np.nan)
    known = drop_registration(parameters)
    responses, names = _responses(rows, rig, marker, known, inverse)
    columns = responses.sum(axis=0)
    stated = columns[:, : len(known.names)]
    random = _random_covariance(rows, np.nan_to_num(value), inverse)
    pan = _pan(rows, responses, known.pan)
    shape = _spot_covariance(rows, len(marker), inverse)
    return RigConsistency(
        value=value,
        random=random,
        systematic=stated @ known.covariance @ stated.T + pan + shape,
        by_source={
            "pixels": _standard_uncertainties(random),
            **_by_source(stated, known),
            "pan angle": _standard_uncertainties(pan),
            "shape of a spot": _standard_uncertainties(shape),
        },
        by_change={
            change: -np.sum([w * columns[:, names.index(n)] for n, w in weights.items()], axis=0)
            for change, (weights, _) in CHANGES.items()
        },
        focal_length=float(rig.right.matrix[1, 1]),
        frame=np.array([r.seen.frame for r in rows], dtype=np.int64),
        series=np.array([r.value for r in rows]),
        left_out=left_out,
    )


def moved_warning(found: RigConsistency, uncounted: Sequence[str]) -> str | None:
    """Say that the rig has moved since it was calibrated; None where nothing shows it.

    Of healthy sessions one in a thousand is accused. `uncounted` as `Systematics.uncounted`:
    sources that state no uncertainty.
    """
    z = np.abs(np.nan_to_num(found.z))
    if not np.any(z > FALSE_ALARM_Z):
        return None
    said = " and ".join(figures_text(found)[i] for i in range(len(FIGURES)) if z[i] > FALSE_ALARM_Z)
    mine = [source for source in uncounted if source in ("rig", "LED positions", "pan angle")]
    doubt = f" (or of {', '.join(mine)}, whose uncertainty is not stated)" if mine else ""
    if len(found.frame) == 1:  # nothing says how the body moved meanwhile
        return (
            f"The only pair does not fit the rig: {said}{doubt}. Either the rig has moved since it "
            "was calibrated, or the robot moved between the two pictures: record more pairs."
        )
    return (
        f"The rig seems to have moved since it was calibrated: {said}. What is measured with it "
        f"carries that error{doubt}. Check it with `verify calibrate check`, and calibrate again."
    )


def unused_leds_warning(measurements: Sequence[Measurement], marker: Marker) -> str | None:
    """Name the LEDs that no measured pair used; None where there are none."""
    used: set[int] = set()
    for m in measurements:
        if m.status == "measured" and m.pose and m.left is not None and m.right is not None:
            led = np.concatenate([m.left.led, m.right.led])
            used.update(led[~m.pose.rejected].tolist())
    unseen = [name for i, name in enumerate(marker.names) if i not in used]
    text = f"Not detected, in any pair, where marker.toml puts them: LED {', '.join(unseen)}. "
    return f"{text}Check that they are lit and in view, and their position_mm." if unseen else None


def figures_text(found: RigConsistency) -> tuple[str, str, str]:
    """The figures in words, mm per metre, to the two digits of their U (k = 2)."""
    value, spread = found.per_metre * found.value, 2 * found.per_metre * found.uncertainty
    digits = np.nan_to_num(1 - np.floor(np.log10(np.maximum(spread, 1e-3)))).clip(0).astype(int)
    size = [f"{abs(v):.{n}f} mm/m" for v, n in zip(value, digits, strict=True)]
    u = [f"(U = {v:.{n}f} mm/m)" for v, n in zip(spread, digits, strict=True)]
    length, height, way = np.where(value > 0, ("long", "low", ""), ("short", "high", "anti"))
    return (
        f"known lengths are measured {size[0]} too {length} {u[0]}",
        f"the right image lies {size[1]} too {height} {u[1]}",
        f"the right image is turned {size[2]} {way}clockwise {u[2]}",
    )


def drop_registration(parameters: Systematics) -> Systematics:
    """Drop what moves neither figure: the robot's base, and the LED body as a whole."""
    keep = [i for i, n in enumerate(parameters.names) if not n.startswith(("robot_base.", "body."))]
    return replace(
        parameters,
        names=tuple(parameters.names[i] for i in keep),
        sources=tuple(parameters.sources[i] for i in keep),
        covariance=parameters.covariance[np.ix_(keep, keep)],
    )


def _reject_outliers(rows: list[PairEquations]) -> tuple[list[PairEquations], tuple[int, ...]]:
    """Leave out pairs far from all others: a reflection, or an LED merged with one."""
    if len(rows) < 3:
        return rows, ()
    values = np.array([r.value for r in rows])
    inverse = invert_shown(np.array([r.information for r in rows]))
    noise = np.sqrt(np.diagonal(inverse, axis1=1, axis2=2))
    noise[:, 1] = np.hypot(noise[:, 1], MODEL_ERROR_PX)
    far = np.zeros(len(rows), dtype=bool)
    for figure, sigma in zip(values.T, noise.T, strict=True):
        shown = ~np.isnan(figure)
        off = np.abs(figure[shown] - np.median(figure[shown])) if shown.any() else figure[shown]
        spread = MAD_TO_SIGMA * np.median(off) if shown.any() else 0.0
        far[shown] |= off > MAX_DEVIATION * np.maximum(spread, sigma[shown])
    kept = [r for r, out in zip(rows, far, strict=True) if not out]
    return kept, tuple(r.seen.frame for r, out in zip(rows, far, strict=True) if out)


def _random_covariance(rows: list[PairEquations], value: Array, inverse: Array) -> Array:
    """What averages out: as the pixels state it, or as the pairs scatter if that is more."""
    information = np.array([row.information for row in rows])
    shown = np.diagonal(information, axis1=1, axis2=2) > 0
    left = np.array([row.wanted for row in rows]) - information @ value
    lower = np.linalg.cholesky(information + ~shown[:, :, None] * np.eye(3))
    white = np.linalg.solve(lower, np.where(shown, left, 0.0)[:, :, None])[:, :, 0]
    white = np.where(shown, white, np.nan)
    shown_in = np.sum(~np.isnan(white), axis=0)
    scatter = np.nansum(white**2, axis=0) / np.maximum(shown_in - 1, 1)
    factor = np.sqrt(np.maximum(scatter, 1.0) * autocorrelation(white))
    return inverse * np.outer(factor, factor)


def _responses(
    rows: list[PairEquations], rig: Rig, marker: Marker, known: Systematics, inverse: Array
) -> tuple[Array, list[str]]:
    """How each pair moves the figures with each parameter stated and each of CHANGES.

    (n, 3, p + 2), d figure / d value in the file, the last two of them the pan readings; and the
    names of the first p.
    """
    more = {n for weights, _ in CHANGES.values() for n in weights if n not in known.names}
    names = [*known.names, *sorted(more)]
    turned = (*names, *PAN_READINGS)
    responses = [
        -(inverse @ row.functional) @ pixel_sensitivities(turned, row.seen, rig, marker)
        for row in rows
    ]
    return np.array(responses), names


def _by_source(columns: Array, known: Systematics) -> dict[str, Array]:
    """Standard uncertainty of each figure from each source that is stated, (3,)."""
    found = {}
    for source in dict.fromkeys(known.sources):
        mine = [i for i, s in enumerate(known.sources) if s == source]
        part = columns[:, mine]
        found[source] = _standard_uncertainties(
            part @ known.covariance[np.ix_(mine, mine)] @ part.T
        )
    return found


def _pan(rows: list[PairEquations], responses: Array, sigma: Array) -> Array:
    """Covariance from the pan readings' errors, (3, 3): a reading that is repeated errs alike."""
    total = np.zeros((3, 3))
    for side in (0, 1):
        if not sigma[side] > 0:
            continue
        reading = np.array([row.pan[side] for row in rows])
        for value in np.unique(reading):
            shared = responses[reading == value, :, side - 2].sum(axis=0) * sigma[side]
            total += np.outer(shared, shared)
    return total


def _spot_covariance(rows: list[PairEquations], leds: int, inverse: Array) -> Array:
    """Covariance from what each spot always misses alike, one camera and LED, (3, 3)."""
    by_spot = np.zeros((3, 2, leds, 2))  # figure, camera, LED, x and y
    for row in rows:
        moved_figures = (inverse @ row.functional).reshape(3, -1, 2)
        m = len(row.led[0])
        by_spot[:, 0, row.led[0]] += moved_figures[:, :m]
        by_spot[:, 1, row.led[1]] += moved_figures[:, m:]
    flat = by_spot.reshape(3, -1) * MODEL_ERROR_PX
    return flat @ flat.T


def _standard_uncertainties(covariance: Array) -> Array:
    return np.sqrt(np.diag(covariance))
