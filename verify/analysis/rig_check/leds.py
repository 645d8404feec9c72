"""Are the LEDs seen where rig.toml and marker.toml put them? Without encoders or robot.

What the poses leave over of the spots is fitted by what is stated, common to all pairs:

    r_i = A_i d_k + C_i c + M m + H_i x_i + noise

    symbol  meaning                                                             unit
    r_i     spots of pair i, measured less predicted by the pair's own pose     px
    A_i     derivative of the spots by LED k's place, flange axes               px/m
    d_k     displacement of one LED, (3,); 0 where nothing is wrong             m
    C_i     columns of unit variance by rig.toml's and marker.toml's            px
            uncertainties; c ~ N(0, 1)
    M       what each camera always misses of each LED; m ~ N(0, 1)             px
    H_i     derivative of the spots by the pose; x_i takes its own errors in    px/m, px

The chi-squared a degree of freedom that is left, the misfit, is 1 where the files agree with the
pictures, whatever the robot does. One LED that explains most of it is named, and so is one camera
that was tilted in the session (`tilt.tilted_camera`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from robots.transforms import rigid_columns
from verify.analysis.rig_check.pair import PosedPair, project_onto, spot_covariance
from verify.analysis.rig_check.tilt import (
    MAX_CHANGES,
    MAX_MISFIT,
    MIN_ADVANTAGE,
    MIN_BESIDE,
    MIN_DROP,
    MIN_SHARE_MORE,
    STRAY,
    TURN_NAMES,
    SpotProducts,
    TiltedCamera,
    beside_instants,
    tilt_warning,
    tilted_camera,
    unlikelihood,
)
from verify.core.fiducials import Marker
from verify.core.records import Array, Index, Measurement
from verify.core.rig import Rig
from verify.measurement.pose import MODEL_ERROR_PX, fit_pose
from verify.measurement.systematics import Systematics, pixel_sensitivities, spot_columns

MAX_PAIRS = 120  # evenly spread: what does not average out rules long before
MIN_LEDS, MIN_PAIRS = 3, 10  # fewer show nothing beside their own pose, or nothing that lasts
LED_SIGMA = 2e-4  # m, of an LED's place where none is stated: a good jig's
MAX_UNSTATED = 5 * LED_SIGMA  # m, that nobody is told of then
TOL_SHOWN = 1e-9  # of the best known axis of a displacement
MAX_SCALE = 0.7  # of what LEDs are off by, in which all of it is one scale
MIN_SHARE = 0.3  # of the misfit beyond noise, that it explains
LED_ADVICE = "check that it is fixed, and measure its place again."
# px, ratios and rad, of each camera of a rig that states no uncertainty
USUAL_RIG = {
    **dict.fromkeys(("fx_px", "fy_px", "cx_px", "cy_px"), 2.0),
    **dict.fromkeys(("k1", "k2"), 0.02),
    **dict.fromkeys(("p1", "p2"), 5e-4),
    **dict.fromkeys(("mount_rx_deg", "pan_zero_deg", "mount_rz_deg"), 2e-3),
}
PART = 5  # the first and the last fifth of the pairs tell what has moved meanwhile
MAX_STRAY_SHARE = 0.1  # of the pairs, of a reflection


@dataclass(frozen=True, slots=True)
class DisplacedLed:
    """An LED that is not where marker.toml puts it."""

    name: str
    displacement: Array  # (3,), m, flange axes
    standard_uncertainty: float  # m, of its length
    begin: float  # s, from when on; -inf: from the first pair on
    end: float  # s, until when; inf: to the last pair


@dataclass(frozen=True, slots=True)
class _LedFit:
    """What the displacement of each LED alone explains of some pairs, beside what is stated."""

    before: float  # chi-squared, of no displacement
    left: Array  # (k,), chi-squared
    shift: Array  # (k, 3), m, flange axes
    covariance: Array  # (k, 3, 3), m², for noise as stated

    def length(self, k: int) -> float:
        """How far LED k is displaced, m."""
        return float(np.linalg.norm(self.shift[k]))


@dataclass(frozen=True, slots=True)
class LedShifts:
    """How far every LED is from where marker.toml puts it, beside the others."""

    leds: Array  # (k, 3), m, flange frame: where they are seen
    shift: Array  # (k, 3), m, flange axes; no motion of the whole body is part of it
    standard_uncertainty: float  # m, of a coordinate

    @property
    def is_scale(self) -> bool:
        """Whether they are mostly larger or smaller as a whole: so a rig measures that is off."""
        about = self.leds - self.leds.mean(axis=0)
        larger = np.sum(self.shift * about) ** 2 / np.sum(about**2)
        return bool(larger > MAX_SCALE * np.sum(self.shift**2))


@dataclass(frozen=True, slots=True)
class PictureMisfit:
    """How well the pictures agree with the files: over all pairs, the first and the last fifth."""

    whole: float
    first: float
    last: float
    led: DisplacedLed | None
    tilted: TiltedCamera | None  # camera, in the session

    @property
    def worst(self) -> float:
        """The largest misfit."""
        return max(self.whole, self.first, self.last)

    @property
    def agrees(self) -> bool:
        """Whether the pictures agree with both files, as far as they can tell."""
        return self.worst < MAX_MISFIT / 2 and not self.contradicts

    @property
    def contradicts(self) -> bool:
        """Whether the pictures contradict rig.toml or marker.toml."""
        return self.led is not None or self.tilted is not None or self.worst > MAX_MISFIT


def picture_misfit(
    measurements: Sequence[Measurement], rig: Rig, marker: Marker, parameters: Systematics
) -> PictureMisfit | None:
    """Compare measured pairs with the files; None where too few LEDs or pairs show anything.

    A rig whose uncertainty is not stated is taken to be as good as usual calibrations.

    Pairs that no pose explains count too, and so do spots that their pose rejects: a displaced LED
    is one of those. A few pairs far from the others, of a reflection, do not.
    """
    (posed, spread), parameters = _posed_pairs(measurements, marker), _with_usual_rig(parameters)
    if not len(spread):
        return None
    every = _products([posed[i] for i in spread], rig, marker, parameters)
    products = _without_strays(every)
    count = max(len(products.pairs) // PART, 1)
    ends = products.part(slice(0, count)), products.part(slice(-count, None))
    whole, first, end = (_misfit(p, len(marker)) for p in (products, *ends))
    found = PictureMisfit(whole, first, end, None, None)
    tilted = tilted_camera(every, len(marker), rig)
    if tilted is not None and len(spread) < len(posed):  # its instants to the pair
        near = beside_instants(np.array([m.t for m, *_ in posed]), spread, tilted)
        every = _products([posed[i] for i in near], rig, marker, parameters)
        tilted = tilted_camera(every, len(marker), rig) or tilted
    if tilted is not None:  # it explains nearly all
        return replace(found, tilted=tilted)
    least = MAX_UNSTATED if "LED positions" in parameters.uncounted else 0.0
    led = _displaced_led(products, marker, least, moved=found.contradicts)
    if led is not None:
        led = _refined(led, [posed[i] for i in spread], rig, marker, parameters)
    return replace(found, led=led)


def led_shifts(
    measurements: Sequence[Measurement], rig: Rig, marker: Marker, parameters: Systematics
) -> LedShifts | None:
    """How far all LEDs are from where `marker` puts them; None where too little shows anything.

    `parameters` as of `picture_misfit`, of the LEDs' places too.
    """
    (posed, spread), parameters = _posed_pairs(measurements, marker), _with_usual_rig(parameters)
    if not len(spread):
        return None
    every = _products([posed[i] for i in spread], rig, marker, parameters)
    products = _without_strays(every)
    total = _beside_stated(products, len(marker), placed=True)
    covariance = np.linalg.pinv(total[:-1, :-1], rcond=TOL_SHOWN, hermitian=True)
    shift = covariance @ total[:-1, -1]
    left = float(total[-1, -1] - shift @ total[:-1, -1]) / max(float(products.freedom.sum()), 1.0)
    variance = float(np.abs(np.diag(covariance)).max()) * max(left, 1.0)
    shift = shift.reshape(-1, 3)
    return LedShifts(marker.leds + shift, shift, variance**0.5)


def shifted_marker(marker: Marker, shifts: LedShifts) -> Marker:
    """The marker with LEDs where they are seen, the body as uncertain as such a file's places are.

    A coordinate has the variance that so many numbers of the body's shape tell (Student's t), at
    least what is stated; the body's pose what a rigid motion fitted to such places has.
    """
    stated, before = marker.led_standard_uncertainty or 0.0, marker.body_standard_uncertainty
    variance = max(np.sum(shifts.shift**2) / max(3 * len(marker) - 8, 1), stated**2)
    columns = rigid_columns(shifts.leds).reshape(-1, 6)
    body = np.sqrt(variance * np.diag(np.linalg.inv(columns.T @ columns)))
    return replace(
        marker,
        leds=shifts.leds,
        led_standard_uncertainty=shifts.standard_uncertainty,
        body_standard_uncertainty=body if before is None else np.hypot(body, before),
    )


def _posed_pairs(
    measurements: Sequence[Measurement], marker: Marker
) -> tuple[list[PosedPair], Index]:
    """Pairs with spots and a pose, and which of them to use; none: they would show nothing."""
    posed: list[PosedPair] = [
        (m, m.pose, m.left, m.right)
        for m in measurements
        if m.pose is not None and m.left is not None and m.right is not None
        if len(m.left) and len(m.right)
    ]
    count = 0 if len(marker) < MIN_LEDS or len(posed) < MIN_PAIRS else min(len(posed), MAX_PAIRS)
    return posed, np.linspace(0, len(posed) - 1, count).astype(int)


def _with_usual_rig(parameters: Systematics) -> Systematics:
    """The same with what calibrations usually leave, of a rig whose uncertainty is not stated."""
    if "rig" not in parameters.uncounted:
        return parameters
    names = tuple(f"{side}.{key}" for side in ("left", "right") for key in USUAL_RIG)
    covariance = block_diag(parameters.covariance, np.diag([*USUAL_RIG.values()] * 2) ** 2)
    sources = (*parameters.sources, *["rig"] * len(names))
    return replace(
        parameters,
        names=(*parameters.names, *names),
        sources=sources,
        covariance=np.asarray(covariance),
    )


def _products(
    pairs: Sequence[PosedPair], rig: Rig, marker: Marker, parameters: Systematics
) -> SpotProducts:
    unstated = "LED positions" in parameters.uncounted
    readings = {(left.pan, right.pan) for _, _, left, right in pairs}
    turning = int(np.count_nonzero(parameters.pan > 0)) if len(readings) > 1 else 0
    products, freedom = [], []
    for seen, pose, left, right in pairs:
        led, spots = np.concatenate([left.led, right.led]), np.arange(len(left) + len(right))
        turn, lefts = pose.rig_T_flange[:3, :3], len(left)
        by_pose = pose.sensitivity @ rigid_columns(marker.leds[led] @ turn.T)
        moved = np.zeros((len(led), 2, len(marker), 3))
        moved[spots, :, led] = pose.sensitivity @ turn
        missed = np.zeros((len(led), 2, 2, len(marker), 2))
        missed[spots, :, (spots >= lefts).astype(int), led] = MODEL_ERROR_PX * np.eye(2)
        stated = spot_columns(
            parameters, rig, marker, left, right, pose.rig_T_flange, pose.sensitivity
        )
        rows = 2 * len(led)
        by_led = moved.reshape(rows, -1)
        columns = [by_led, by_led * (LED_SIGMA * unstated), stated, missed.reshape(rows, -1)]
        turns = pixel_sensitivities(TURN_NAMES, seen, rig, marker)
        late = by_pose @ np.nan_to_num(pose.twist) * (spots >= lefts)[:, None]
        rest = pose.residual.reshape(rows, 1), late.reshape(rows, 1), turns
        every = np.concatenate([*columns, *rest], axis=1)
        covariance = spot_covariance([(seen, pose, left, right)], by_pose[None])[0]
        read = stated[:, stated.shape[1] - turning :]  # each reading of a pan angle errs by itself
        covariance += read @ read.T
        lower = np.linalg.cholesky(covariance)
        white = solve_triangular(lower, np.hstack([every, by_pose.reshape(rows, 6)]), lower=True)
        left_of = white[:, :-6] - project_onto(white[:, -6:], white[:, :-6])
        products.append(left_of.T @ left_of)
        freedom.append(rows - pose.known_dof)
    t = np.array([seen.t for seen, *_ in pairs])
    return SpotProducts(np.array(products), np.array(freedom, dtype=float), t)


def _without_strays(products: SpotProducts) -> SpotProducts:
    """Leave out a few pairs far from the others."""
    size = products.pairs[:, -1, -1] / np.maximum(products.freedom, 1.0)
    stray = size > STRAY * np.median(size)
    if stray.sum() > MAX_STRAY_SHARE * len(stray):
        return products
    return products.part(~stray)


def _beside_stated(products: SpotProducts, leds: int, *, placed: bool) -> Array:
    """Products of the LEDs' columns (3 a LED) and the residual, beside what is stated.

    `placed`: LEDs are where marker.toml puts them, but for what is stated; else as far as a good
    jig puts them, where nothing is.
    """
    total = products.pairs.sum(axis=0)
    own, stated = [*range(3 * leds), len(total) - 1], slice((6 if placed else 3) * leds, -1)
    beside = total[stated][:, own]
    held = total[stated, stated] + np.eye(len(beside))  # of unit variance
    return np.asarray(total[np.ix_(own, own)] - beside.T @ np.linalg.solve(held, beside))


def _misfit(products: SpotProducts, leds: int) -> float:
    left = _beside_stated(products, leds, placed=False)
    return float(left[-1, -1] / max(products.freedom.sum(), 1.0))


def _displaced_led(
    products: SpotProducts, marker: Marker, least: float, *, moved: bool
) -> DisplacedLed | None:
    """The one LED whose displacement explains most of the misfit; None where none does.

    Of all pairs, or, if it may have `moved` in the session, of those that one or two instants
    bound. `least`, m: displacements up to that are none, unless the pictures contradict the files,
    and but for that LED do not.
    """
    rows, n = max(float(products.freedom.sum()), 1.0), len(products.t)
    change = 3 * np.log(rows) + 2 * np.log(n)  # the price of another place, and of the instant

    @cache
    def fit(start: int, stop: int) -> _LedFit:
        return _fit_leds(products.part(slice(start, stop)), len(marker))

    def left(edges: tuple[int, ...]) -> Array:
        return np.asarray(np.sum([fit(*part).left for part in pairwise(edges)], axis=0))

    def costs(edges: tuple[int, ...]) -> Array:
        price = change * (len(edges) - 2)
        return np.array([unlikelihood(x, rows) + price for x in left(edges).tolist()])

    edges: tuple[int, ...] = (0, n)
    before, fewest = fit(0, n).before / rows, costs(edges)
    for _ in range(MAX_CHANGES if moved else 0):
        cuts = [c for c in range(n) if min(abs(c - e) for e in edges) >= MIN_BESIDE]
        split = [tuple(sorted((*edges, cut))) for cut in cuts]
        best = min(split, key=lambda some: left(some).min(), default=edges)
        if left(best).min() > left(edges).min() - MIN_SHARE_MORE * before * rows:
            break
        fewest = np.minimum(fewest, np.min([costs(some) for some in split], axis=0))
        edges = best
    k, cost = int(np.argmin(left(edges))), costs(edges)
    after = float(left(edges)[k]) / rows
    shown = unlikelihood(before * rows, rows) - cost[k] > MIN_DROP
    if not shown or np.delete(fewest, k).min() - cost[k] < MIN_ADVANTAGE:
        return None
    start, stop = max(pairwise(edges), key=lambda part: fit(*part).length(k))
    found = fit(start, stop)
    explains = before - after > MIN_SHARE * (before - 1.0)
    if not explains or (found.length(k) <= least and not after < MAX_MISFIT < before):
        return None
    between = np.concatenate([[-np.inf], (products.t[1:] + products.t[:-1]) / 2, [np.inf]])
    begin, end = between[[start, stop]].tolist()
    return DisplacedLed(marker.names[k], found.shift[k], np.nan, begin, end)


def _refined(
    found: DisplacedLed,
    pairs: Sequence[PosedPair],
    rig: Rig,
    marker: Marker,
    parameters: Systematics,
) -> DisplacedLed | None:
    """The same LED beside poses that have it where it was found; None: strays alone show it."""
    k, leds = marker.names.index(found.name), marker.leds.copy()
    leds[k] += found.displacement
    there = replace(marker, leds=leds)
    posed = [
        (seen, fit_pose(left, right, rig, there, pose.rig_T_flange), left, right)
        for seen, pose, left, right in pairs
        if found.begin < seen.t < found.end
    ]
    products = _without_strays(_products(posed, rig, there, parameters))
    fit = _fit_leds(products, len(marker))
    scatter = max(float(fit.left[k] / products.freedom.sum()), 1.0)
    shift = found.displacement + fit.shift[k]
    along = shift / np.linalg.norm(shift)
    u = float(np.sqrt(along @ fit.covariance[k] @ along * scatter))
    return replace(found, displacement=shift, standard_uncertainty=u) if u else None


def _fit_leds(products: SpotProducts, leds: int) -> _LedFit:
    own = np.arange(3 * leds).reshape(leds, 3)
    total = _beside_stated(products, leds, placed=True)
    normal, moment = total[own[:, :, None], own[:, None, :]], total[own, -1]
    # of three LEDs one moves out of their plane without a trace
    covariance = np.linalg.pinv(normal, rcond=TOL_SHOWN, hermitian=True)
    shift = np.einsum("kij,kj->ki", covariance, moment)
    before = float(total[-1, -1])
    return _LedFit(before, before - np.sum(shift * moment, axis=1), shift, np.asarray(covariance))


def displacement_text(led: DisplacedLed) -> str:
    """Say which LED is not in its place, how far off, and when."""
    length, u = np.linalg.norm(led.displacement) * 1e3, led.standard_uncertainty * 1e3
    x, y, z = (np.round(1e3 * led.displacement, 2) + 0.0).tolist()  # no -0.00
    since = "" if np.isinf(led.begin) else f" from t_left_s = {led.begin:.2f} on"
    until = "" if np.isinf(led.end) else f" until t_left_s = {led.end:.2f}"
    return (
        f"LED {led.name} is seen {length:.2f} mm (U = {2 * u:.2f} mm; x {x:+.2f}, y {y:+.2f}, "
        f"z {z:+.2f} mm, flange axes) from its place in marker.toml{since}{until}"
    )


def shifts_text(shifts: LedShifts, marker: Marker) -> str:
    """Say that the LEDs are not in their places in marker.toml, and what all figures rest on."""
    far = zip(marker.names, np.linalg.norm(shifts.shift, axis=1).tolist(), strict=True)
    return (
        "The LEDs are not where marker.toml puts them beside each other: "
        f"{', '.join(f'{name} {length * 1e3:.2f}' for name, length in far)} mm off (U = "
        f"{2e3 * shifts.standard_uncertainty:.2f} mm a coordinate). All figures rest on the places "
        "that the pictures show. Where they stand as a body no picture shows: that is taken to be "
        "as uncertain as places are that are so far off. Measure them again."
    )


def misfit_warning(found: PictureMisfit, *, told: bool) -> str | None:
    """Say that the pictures contradict rig.toml or marker.toml; None where they agree.

    `told`: another warning says so already, and only an LED or a camera is worth a second one.
    """
    agreed, later = found.first < MAX_MISFIT / 2, found.last < MAX_MISFIT / 2
    if found.tilted is not None:
        return tilt_warning(found.tilted)
    if found.led is not None:
        return (
            f"{displacement_text(found.led)}. Errors and causes may come from that and not from "
            f"the robot: {LED_ADVICE}"
        )
    if told or not found.contradicts:
        return None
    when = "; in the first pairs they agree, so something has moved since" if agreed else ""
    if agreed and later:
        when = "; in the first and the last pairs they agree, and not between"
    return (
        f"The LEDs are seen {np.sqrt(found.worst):.0f} times as far from where rig.toml and "
        f"marker.toml put them as their uncertainties and the pixels' noise explain{when}. Errors "
        "and causes may come from that and not from the robot: check that both files belong to the "
        "pictures, the lenses, line_time_s and the cameras' times, and that no camera or LED has "
        "moved."
    )
