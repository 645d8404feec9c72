"""One camera's turn in the session, by what the poses leave over of the spots of all pairs.

    r_i = C_i c + M m + T_i (b_0 + sum_s h_s(t_i) b_s) + H_i x_i + noise

    symbol  meaning                                                             unit
    T_i     derivative of the spots by turns of a camera, x, pan axis and z     px/rad
    b_0     its turn at the beginning, whatever it is                           rad
    h_s     0, then 1: a step, or a line from the beginning or to the end       1
    b_s     what the turn grows by                                              rad

The other terms are those of `leds`. Rays that no longer meet show it, whatever body or robot do. A
turn about the pan axis alone shows as distance, and is sought among the causes.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from verify.core.records import Array, Flags, Index
from verify.core.rig import Rig
from verify.measurement.pose import MODEL_ERROR_PX

MAX_MISFIT = 4.0  # residuals of twice what is stated
MIN_DROP = 30.0  # of chi-squared, by what is displaced: healthy sessions stay below 12
MIN_ADVANTAGE = 15.0  # of chi-squared, over the next explanation
STRAY = 16.0  # times the usual chi-squared: a reflection
MIN_BESIDE = 3  # pairs before and after a tilt; fewer are strays
TURNS = ("mount_rx_deg", "pan_zero_deg", "mount_rz_deg")  # of a camera
TURN_NAMES = tuple(f"{side}.{name}" for side in ("left", "right") for name in TURNS)
AT_TURN = np.array([[-6, -5, -4], [-3, -2, -1]])  # columns of them, of the left and right camera
AT_RESIDUAL, AT_LATE = -8, -7  # beside them; by a second that the right pictures are late
TOL_TURN = 1e-9  # of the best known axis: one less known is not shown
MIN_SHIFT_PX = 2 * MODEL_ERROR_PX  # lenses and LEDs make as much
PARTS = 20  # of a session, after some of which a camera that creeps begins or stands
MAX_CHANGES = 2  # of a camera: it may be put back
MIN_SHARE_TILT = 0.9  # of the misfit beyond noise: late pictures look like many tilts
MIN_SHARE_MORE = 0.05  # that a further one explains: pairs aligned across it miss some of it


@dataclass(frozen=True, slots=True)
class TiltedCamera:
    """One camera's turn in the session, about its pan axis the least: of which one nobody knows."""

    knots: tuple[Array, ...]  # of each shape, s: a step at the only one, or a line between two
    sizes: Array  # (2, k, 3), rad, of the shapes, were it the left camera, the right one
    angle: float  # rad, of the tilt alone, the largest of all pairs
    standard_uncertainty: float  # rad, by which camera it was too
    shift: float  # px, by which the tilt moves a picture
    explains: float  # of the misfit beyond noise

    def at(self, t: Array) -> Array:
        """The turn since the first pair at instants (n,), were it either camera, (2, n, 3), rad."""
        return np.stack([_shape(t, knots) for knots in self.knots], axis=1) @ self.sizes

    @property
    def begin(self) -> float | None:
        """When it happened, s; None of a camera that creeps."""
        first = self.knots[0]
        return float(first[0]) if len(first) == 1 else None


@dataclass(frozen=True, slots=True)
class SpotProducts:
    """Products of whitened columns of pairs: 3 a LED, what is stated, residual, lateness, turns."""

    every: Array  # (n, k + 7, k + 7)
    freedom: Array  # (n,), of each pair's spots beside its pose
    t: Array  # (n,), s

    @property
    def pairs(self) -> Array:
        """The same up to the residual, (n, k, k)."""
        return self.every[:, : AT_RESIDUAL + 1, : AT_RESIDUAL + 1]

    def part(self, rows: slice | Flags) -> "SpotProducts":
        """The products of some of the pairs."""
        return SpotProducts(self.every[rows], self.freedom[rows], self.t[rows])


def _shape(t: Array, knots: Array) -> Array:
    """A step at the only knot, or a line from 0 at the first to 1 at the second, at t (n,)."""
    return (t >= knots[0]) * 1.0 if len(knots) == 1 else np.interp(t, knots, [0.0, 1.0])


@dataclass(frozen=True)
class _TurnScan:
    """What turns of a camera about `axes` explain of pairs (n) beside what is stated.

    Beside shapes that were found, and turns about all axes that were there at the beginning.
    """

    products: SpotProducts
    leds: int
    side: int  # 0 left, 1 right
    found: tuple[Array, ...] = ()  # knots of each
    axes: tuple[int, ...] = (0, 1, 2)

    @property
    def shape(self) -> Array:
        """The shapes found at the pairs, (n, k)."""
        none = np.zeros((0, len(self.products.t)))
        return np.vstack([none, *(_shape(self.products.t, knots) for knots in self.found)]).T

    @cached_property
    def _known(self) -> tuple[Array, Array, Array]:
        """Inverse of what is stated and found, (m, m), its products with the residual (m,).

        With them each pair's products with its turns, (n, 3, m).
        """
        every, turn, at = self.products.every, AT_TURN[self.side], AT_RESIDUAL
        part, stated = turn[list(self.axes)], np.arange(3 * self.leds, every.shape[1] + at)
        columns = np.concatenate([stated, turn])
        whole, shape = every.sum(axis=0), self.shape
        grown = [np.einsum("n,nij->ij", h, every[:, part]) for h in shape.T]
        squares = np.einsum("na,nb,nij->aibj", shape, shape, every[:, part[:, None], part])
        crossed = np.concatenate([np.zeros((0, every.shape[1])), *grown])
        fixed, free = len(columns), len(crossed)
        normal = np.zeros((fixed + free, fixed + free))
        normal[:fixed, :fixed] = whole[np.ix_(columns, columns)]
        normal[range(len(stated)), range(len(stated))] += 1.0  # of unit variance
        normal[fixed:, :fixed] = crossed[:, columns]
        normal[:fixed, fixed:] = crossed[:, columns].T
        normal[fixed:, fixed:] = squares.reshape(free, free)
        own = np.einsum("na,nij->niaj", shape, every[:, turn[:, None], part]).reshape(
            len(every), len(turn), free
        )
        by_pair = np.concatenate([every[:, turn[:, None], columns], own], axis=2)
        size = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))  # pixels a rad beside shares of one
        inverse = np.linalg.pinv(normal * np.outer(size, size), hermitian=True)
        moment = np.concatenate([whole[columns, at], crossed[:, at]])
        return inverse * np.outer(size, size), moment, by_pair

    @property
    def left(self) -> float:
        """Chi-squared that is left."""
        inverse, moment, _ = self._known
        power = self.products.every[:, AT_RESIDUAL, AT_RESIDUAL].sum()
        return float(power - moment @ inverse @ moment)

    def gains(self, shapes: Array) -> Array:
        """By how much one more of shapes (n, c) would lower it, (c,)."""
        inverse, moment, by_pair = self._known
        every, turn = self.products.every, AT_TURN[self.side]
        own, seen = every[:, turn[:, None], turn], every[:, turn, AT_RESIDUAL]
        beside, part = np.tensordot(shapes.T, by_pair, 1), shapes.T @ seen
        part = part - beside @ (inverse @ moment)
        block = np.tensordot(shapes.T**2, own, 1) - beside @ inverse @ beside.swapaxes(1, 2)
        solved = np.linalg.pinv(block, rcond=TOL_TURN, hermitian=True) @ part[:, :, None]
        gains: Array = np.sum(part * solved[:, :, 0], axis=1)
        return gains

    def sizes(self) -> tuple[Array, Array]:
        """What the shapes found are worth, (k, a), rad, and their covariance (k, a, k, a)."""
        inverse, moment, _ = self._known
        form = self.shape.shape[1], len(self.axes)
        count = form[0] * form[1]
        sizes, spread = (inverse @ moment)[-count:], inverse[-count:, -count:]
        return sizes.reshape(form), spread.reshape(*form, *form)


def tilted_camera(products: SpotProducts, leds: int, rig: Rig) -> TiltedCamera | None:
    """The tilts of one camera in the session that explain most of the misfit; None: none does.

    Pairs that no turn explains, of a reflection, do not count.
    """
    products = _without_unturned(products)
    rows = max(float(products.freedom.sum()), 1.0)
    before = scan = _TurnScan(products, leds, side=1)
    candidates = _candidates(products.t, rows)
    shapes = np.stack([_shape(products.t, knots) for knots, _ in candidates], axis=1)
    for _ in range(MAX_CHANGES):
        left = (scan.left - scan.gains(shapes)).tolist()
        costs = [unlikelihood(x, rows) + c for x, (_, c) in zip(left, candidates, strict=True)]
        best = int(np.argmin(costs))
        enough = scan.left - MIN_SHARE_MORE * before.left * bool(scan.found)
        if costs[best] + MIN_ADVANTAGE > unlikelihood(scan.left, rows) or left[best] > enough:
            break
        scan = replace(scan, found=(*scan.found, candidates[best][0]))
    scan = _without_idle(scan, rows)
    beyond = before.left / rows - 1.0
    turned = replace(scan, axes=(1,)).left  # about the pan axis alone
    drop = (min(turned, before.left) - scan.left) / rows
    scatter = max(scan.left / rows, 1.0)
    if drop * rows < MIN_DROP * scatter or drop < MIN_SHARE_TILT * beyond:
        return None
    if _left_by_late_pictures(products, leds) < scan.left + MIN_ADVANTAGE * scatter:
        return None
    scans = replace(scan, side=0), scan
    turns = [one.shape @ one.sizes()[0] for one in scans]
    angles = [np.hypot(turn[:, 0], turn[:, 2]) for turn in turns]
    likelier = int(scans[1].left <= scans[0].left)
    most = int(np.argmax(angles[likelier]))
    angle, other = float(angles[likelier][most]), float(angles[1 - likelier][most])
    turn, spread = turns[likelier][most] * [1.0, 0.0, 1.0], scans[likelier].sizes()[1]
    along = np.outer(scan.shape[most], turn / max(angle, 1e-300))
    variance = float(np.einsum("ai,aibj,bj", along, spread, along)) * scatter
    focal, quarter = float(rig.right.matrix[1, 1]), rig.image_size[0] / 4
    shift = float(np.hypot(focal * turn[0], quarter * turn[2]))
    if shift < MIN_SHIFT_PX:
        return None
    return TiltedCamera(
        knots=scan.found,
        sizes=np.stack([one.sizes()[0] for one in scans]),
        angle=angle,
        standard_uncertainty=float(np.sqrt(variance + (angle - other) ** 2 / 2)),
        shift=shift,
        explains=min(drop / beyond, 1.0),
    )


def _left_by_late_pictures(products: SpotProducts, leds: int) -> float:
    """Chi-squared that is left if the right pictures are late instead, of a body that moves."""
    whole = products.every.sum(axis=0)
    columns = [*range(3 * leds, len(whole) + AT_RESIDUAL), len(whole) + AT_LATE]
    normal, moment = whole[np.ix_(columns, columns)], whole[columns, AT_RESIDUAL]
    normal += np.diag([1.0] * (len(columns) - 1) + [0.0])  # of unit variance
    size = 1 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal * np.outer(size, size), hermitian=True)
    return float(whole[AT_RESIDUAL, AT_RESIDUAL] - (size * moment) @ inverse @ (size * moment))


def unlikelihood(left: float, rows: float) -> float:
    """Twice the negative log likelihood of what is left, of a scatter that is at least noise."""
    return left if left < rows else rows * (1.0 + float(np.log(left / rows)))


def _without_idle(scan: _TurnScan, rows: float) -> _TurnScan:
    """Leave out a shape that those found later explain: a line, of a camera that is put back."""
    fewer = replace(scan, found=scan.found[1:])
    price = len(TURNS) * float(np.log(rows))
    idle = unlikelihood(fewer.left, rows) < unlikelihood(scan.left, rows) + price
    return fewer if len(scan.found) > 1 and idle else scan


def _without_unturned(products: SpotProducts) -> SpotProducts:
    """Leave out pairs that no turn of a camera explains; one counts for fewer, the less it does."""
    every, turn = products.every, AT_TURN[1]
    moment, free = every[:, turn, AT_RESIDUAL], np.maximum(products.freedom - len(turn), 1.0)
    inverse = np.linalg.pinv(every[:, turn[:, None], turn], rcond=TOL_TURN, hermitian=True)
    turned = np.einsum("ni,nij,nj->n", moment, inverse, moment)
    size = (every[:, AT_RESIDUAL, AT_RESIDUAL] - turned) / free
    usual = max(float(np.median(size)), 1.0)
    weight = 1 / np.maximum(size / (MAX_MISFIT * usual), 1.0)
    weighed = replace(products, every=every * weight[:, None, None])
    return weighed.part(size <= STRAY * usual)


def _candidates(t: Array, rows: float) -> list[tuple[Array, float]]:
    """Knots of shapes that may be, at pairs at t (n,), and what each has to explain."""
    turn, span = len(TURNS) * float(np.log(rows)), t[-1] - t[0]
    begins = (t[MIN_BESIDE - 1 : -MIN_BESIDE] + t[MIN_BESIDE : len(t) - MIN_BESIDE + 1]) / 2
    middles = t[0] + span * np.arange(1, PARTS) / PARTS
    ramps = [ends for middle in middles for ends in ((t[0], middle), (middle, t[-1]))]
    uneven = turn + 2 * float(np.log(2 * PARTS)) + MIN_ADVANTAGE
    return [
        (t[[0, -1]], turn),
        *((np.array([begin]), turn + 2 * float(np.log(len(t)))) for begin in begins),
        *((np.array(ends), uneven) for ends in ramps),
    ]


def beside_instants(t: Array, spread: Index, tilted: TiltedCamera) -> Index:
    """Pairs that are spread, and those about the instants at which a camera was tilted."""
    near = [spread]
    for knots in tilted.knots:
        if len(knots) == 1:
            after = int(np.searchsorted(t[spread], knots[0]))
            near.append(np.arange(spread[max(after - 1, 0)], spread[min(after, len(spread) - 1)]))
    return np.unique(np.concatenate(near))


def tilt_warning(found: TiltedCamera) -> str:
    """Say that a camera was tilted in the session, when and how far, and what to do."""
    when = "little by little" if found.begin is None else f"at t_left_s = {found.begin:.2f}"
    angle, u = np.degrees(found.angle), 2 * np.degrees(found.standard_uncertainty)
    return (
        f"A camera was tilted in the session, {when}: by {angle:.3f}° (U = {u:.3f}°), which moves "
        f"its picture by {found.shift:.1f} px; which of the two, the pictures do not tell. What it "
        "may have done to the poses is in the uncertainties of all errors. Fix both cameras, "
        "calibrate the rig and record again."
    )
