"""Give each LED of a hypothesis the spot that it explains, and settle which hypotheses stay.

With u an LED's predicted image, J its derivative by pose and shift, C their covariance, V that of
spot z, the spot costs

    (z - u)' (V + J C J' + play²)⁻¹ (z - u) + what it costs that z is merged with another

beyond the gate it is none of the LED's. Two steps alternate until the spots are those that the
poses explain: Gauss-Newton steps on pose and shift with the spots held, and the choice of spots
with the pose held. Hypotheses that come to the same spots are one.
"""

import math

import numpy as np

from verify.core.jit import compiled
from verify.core.kernels.linear_algebra import copy_to, dot
from verify.core.records import Array
from verify.measurement.correspondence.kernels.fit import (
    CHI2,
    COVARIANCE,
    HOLD,
    N_FREE,
    N_STATE,
    POSITION,
    SHIFT,
    Limits,
    Scene,
    begin_fit,
    fit_all,
    predict_image,
)
from verify.measurement.correspondence.kernels.points import MAX_DEVIATION, Index

MAX_GATE = 10.0  # px, an LED predicted worse than this could be any spot
# 2 ln of how much denser spots are at an LED (half a px) than clutter (20 an image)
SPOT_REWARD = 20.0
MERGED_COST = 9.0  # of the same kind: a clean spot is taken unless it lies 3 sigma farther off
ALIKE_CHI2 = 9.0  # by which a pose has to fit better than the one that continues the motion
UNPAIRED_COST = 7.0  # 2 ln 30: an LED in one camera's view is hidden from the other once in 30
DOF_BY_LEDS = (0, 3, 5, 6)  # degrees of freedom, by LEDs seen: three determine all


@compiled
def choose_spots(cost: Array, spot: Index) -> None:
    """Give every LED the cheapest of those spots (n, s) that no other LED gets cheaper."""
    leds, spots = cost.shape
    for k in range(spots):
        least = math.inf
        for led in range(leds):
            least = min(least, cost[led, k])
        for led in range(leds):
            if cost[led, k] > least:
                cost[led, k] = math.inf
    for led in range(leds):
        spot[led], least = -1, math.inf
        for k in range(spots):
            if cost[led, k] < least:
                spot[led], least = k, cost[led, k]


@compiled
def gather_all(scene: Scene, limits: Limits, state: Array, spot: Index, largest: float) -> bool:
    """Fill in the spot (h, 2, n) that each LED gets in each image, -1 for none.

    `state` (h, 85), as `fit_all` has it; an LED whose place is known worse than `largest`, px, gets
    none. Says whether any has changed.
    """
    pixels, noise, merged, allowed, leds = scene[3], scene[4], scene[5], scene[6], scene[7]
    nearest, play, _ = limits
    cost, image = np.empty((allowed.shape[1], allowed.shape[2])), np.empty(2)
    slope, own, changed = np.zeros((2, N_FREE)), np.empty(len(leds), np.int64), False
    for h in range(len(state)):
        rotation, position = state[h, :POSITION].reshape(3, 3), state[h, POSITION:SHIFT]
        covariance = state[h, COVARIANCE:].reshape(N_FREE, N_FREE)
        for side in range(2):
            slope[0, 6] = slope[1, 7] = float(side)
            for led in range(len(cost)):
                depth = predict_image(scene, side, led, rotation, position, nearest, image, slope)
                xx, xy, yy = 0.0, 0.0, 0.0  # variance of the predicted image, px²
                for i in range(N_FREE):
                    x, y = 0.0, 0.0
                    for j in range(N_FREE):
                        x += slope[0, j] * covariance[j, i]
                        y += slope[1, j] * covariance[j, i]
                    xx += x * slope[0, i]
                    xy += x * slope[1, i]
                    yy += y * slope[1, i]
                placed = xx + yy <= 2 * largest * largest and depth > nearest
                play2 = (play / max(depth, nearest)) ** 2
                for k in range(cost.shape[1]):
                    cost[led, k] = math.inf
                    x = pixels[side, k, 0] - (image[0] + side * state[h, SHIFT])
                    y = pixels[side, k, 1] - (image[1] + side * state[h, SHIFT + 1])
                    a = noise[side, k, 0, 0] + (xx + play2)
                    b = noise[side, k, 0, 1] + xy
                    d = noise[side, k, 1, 1] + (yy + play2)
                    squared = (d * x * x - 2 * b * x * y + a * y * y) / (a * d - b * b)
                    if allowed[side, led, k] and placed and squared <= MAX_DEVIATION**2:
                        cost[led, k] = squared + MERGED_COST * merged[side, k]
            choose_spots(cost, own)
            for led in range(len(leds)):
                changed = changed or spot[h, side, led] != own[led]
                spot[h, side, led] = own[led]
    return changed


@compiled
def keep_rows(state: Array, spot: Index, rows: Index) -> None:
    """Bring some hypotheses to the front, in their order."""
    figures, assigned = state.copy(), spot.copy()
    for place in range(len(rows)):
        copy_to(state[place], figures[rows[place]])
        for side in range(2):
            copy_to(spot[place, side], assigned[rows[place], side])


@compiled
def same_spots(one: Index, other: Index) -> bool:
    """Whether two assignments (2, n) are the same."""
    for side in range(2):
        for led in range(one.shape[1]):
            if one[side, led] != other[side, led]:
                return False
    return True


@compiled
def keep_unique(state: Array, spot: Index, count: int) -> int:
    """Bring the best fit of each assignment to the front: two poses of a flat marker may share one.

    Of the first `count` hypotheses; gives how many there are, best first.
    """
    if count < 2:
        return count
    order, kept = np.empty(count, np.int64), 0
    for h in range(count):
        place = h
        while place > 0 and state[h, CHI2] < state[order[place - 1], CHI2]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = h
    for h in range(count):
        new = True
        for k in range(kept):
            new = new and not same_spots(spot[order[k]], spot[order[h]])
        if new:
            order[kept] = order[h]
            kept += 1
    keep_rows(state, spot, order[:kept])
    return kept


@compiled
def keep_followed(state: Array, spot: Index, followed: int, others: int) -> int:
    """Bring to the front what follows a prediction, and other assignments; gives how many.

    `followed`, 0 or 1, of row 0, and `others`, of the rows behind it, count. An assignment has the
    followed pose unless another one of it fits far better: a doubtful spot leaves a marker two.
    """
    order, kept, first = np.empty(1 + others, np.int64), 0, followed == 1
    for h in range(1, 1 + others):
        same = followed == 1 and same_spots(spot[0], spot[h])
        better = state[h, CHI2] < state[0, CHI2] - ALIKE_CHI2
        first = first and not (same and better)
        if better or not same:
            order[kept] = h
            kept += 1
    if first:
        for k in range(kept, 0, -1):
            order[k] = order[k - 1]
        order[0] = 0
        kept += 1
    keep_rows(state, spot, order[:kept])
    return kept


@compiled
def keep_likely(state: Array, spot: Index, count: int, bounds: Array) -> int:
    """Bring those to the front that see an LED in both images and fit within their noise.

    `bounds` (4 n + 1,): the greatest chi², by degrees of freedom.
    """
    likely, kept = np.empty(count, np.int64), 0
    used, leds, both = count_all(spot[:count])
    for h in range(count):
        freedom = max(2 * used[h] - DOF_BY_LEDS[min(leds[h], 3)], 1)
        if both[h] > 0 and state[h, CHI2] <= bounds[freedom]:
            likely[kept] = h
            kept += 1
    if kept < count:
        keep_rows(state, spot, likely[:kept])
    return kept


@compiled
def settle(scene: Scene, limits: Limits, state: Array, spot: Index, bounds: Array) -> int:
    """Gather and fit until the spots are those of the poses; keep each good assignment once.

    Gives how many; they stand in front, best first.
    """
    gather_all(scene, limits, state, spot, MAX_GATE)
    count = keep_unique(state, spot, len(state))
    fit_all(scene, limits, state[:count], spot[:count], 1)
    if gather_all(scene, limits, state[:count], spot[:count], MAX_GATE):
        fit_all(scene, limits, state[:count], spot[:count], 2)
    return keep_unique(state, spot, keep_likely(state, spot, count, bounds))


@compiled
def refine(scene: Scene, limits: Limits, state: Array, spot: Index, bounds: Array) -> int:
    """Fit hypotheses in place, gather what each pose explains, fit again; see `settle`."""
    fit_all(scene, limits, state, spot, 2)  # steps: from a few mm off they leave 0.01 px
    return settle(scene, limits, state, spot, bounds)


@compiled
def follow(
    scene: Scene,
    limits: Limits,
    found: tuple[Array, Index],
    rig_T_flange: Array,
    sigmas: tuple[float, float, float],
    bounds: Array,
) -> tuple[Array, Index]:
    """Take the spots nearest to a predicted pose (4, 4), alone and from what was found.

    LEDs that one camera alone sees are looked for anew. `sigmas` as in `begin_fit`. Gives what
    `settle` keeps: `state` and spots, as `found`.
    """
    count = 1 + len(found[0])
    state, spot = np.empty((count, N_STATE)), np.full((count, 2, found[1].shape[2]), -1)
    begin_fit(state[0], sigmas)
    for i in range(3):
        state[0, POSITION + i] = rig_T_flange[i, 3]
        for j in range(3):
            state[0, 3 * i + j] = rig_T_flange[i, j]
    for h in range(1, count):
        copy_to(state[h], found[0][h - 1])
        copy_to(state[h, HOLD:CHI2], state[0, HOLD:CHI2])
        for side in range(2):
            copy_to(spot[h, side], found[1][h - 1, side])
    gather_all(scene, limits, state[:1], spot[:1], math.inf)
    # one assignment, every LED with a spot and no spot left, that fits so well that no assignment
    # with an LED less would have more evidence
    used, leds = count_all(spot[1:])[0], spot.shape[2]
    complete = len(used) == 1 and used[0] == 2 * leds and scene[3].shape[1] == leds
    complete = complete and state[1, CHI2] < SPOT_REWARD + UNPAIRED_COST
    if complete and same_spots(spot[0], spot[1]):
        fit_all(scene, limits, state, spot, 2)
        count = keep_followed(state, spot, 1, 1)
        fit_all(scene, limits, state[:count], spot[:count], 1)
        return state[:count], spot[:count]
    fit_all(scene, limits, state[1:], spot[1:], 0)
    gather_all(scene, limits, state[1:], spot[1:], math.inf)
    fit_all(scene, limits, state, spot, 2)
    followed = settle(scene, limits, state[:1], spot[:1], bounds)
    others = settle(scene, limits, state[1:], spot[1:], bounds)
    count = keep_followed(state, spot, followed, others)
    return state[:count], spot[:count]


@compiled
def count_all(spot: Index) -> Index:
    """Count, for assignments (h, 2, n), -1 for no spot, what they use; (3, h).

    Spots in use, LEDs with a spot in an image, and LEDs with one in both.
    """
    counts = np.zeros((3, len(spot)), np.int64)
    for h in range(len(spot)):
        for led in range(spot.shape[2]):
            left, right = spot[h, 0, led] >= 0, spot[h, 1, led] >= 0
            counts[0, h] += left + right
            counts[1, h] += left or right
            counts[2, h] += left and right
    return counts


@compiled
def departures_of_all(
    leds: Array, spot: Index, state: Array, rig_T_flange: Array, scales: tuple[float, float, float]
) -> Array:
    """Measure how far the LEDs of each hypothesis (h,) are from where a reference pose has them.

    `leds` (n, 3), m, flange frame; `spot` (h, 2, n), -1 for none; `state` (h, 85), as `fit_all` has
    it; `rig_T_flange` (4, 4), the reference; `scales`: position (m), rotation (rad), and how well a
    coarse pose places an LED (m).
    """
    along, about, coarse = scales
    moves, mean, middle = np.empty((len(leds), 3)), np.empty(3), np.empty(3)
    off = np.empty(len(state))
    for h in range(len(off)):
        count = 0
        for led in range(len(leds)):
            count += max(spot[h, 0, led], spot[h, 1, led]) >= 0
        mean[:], middle[:] = 0.0, 0.0
        share = 1.0 / max(count, 1)
        for led in range(len(leds)):
            weight = share if max(spot[h, 0, led], spot[h, 1, led]) >= 0 else 0.0
            for i in range(3):
                move = state[h, POSITION + i] - rig_T_flange[i, 3]
                for j in range(3):
                    move += (state[h, 3 * i + j] - rig_T_flange[i, j]) * leds[led, j]
                moves[led, i] = move
                mean[i] += weight * move
                middle[i] += weight * leds[led, i]
        radius, turned = 0.0, 0.0
        for led in range(len(leds)):
            weight = share if max(spot[h, 0, led], spot[h, 1, led]) >= 0 else 0.0
            for i in range(3):
                radius += weight * (leds[led, i] - middle[i]) ** 2
                turned += weight * (moves[led, i] - mean[i]) ** 2
        lever, moved = math.sqrt(dot(middle, middle)), math.sqrt(dot(mean, mean))
        off[h] = math.hypot(
            moved / (along + about * lever + coarse),
            math.sqrt(turned) / (about * math.sqrt(radius) + coarse),
        )
    return off
