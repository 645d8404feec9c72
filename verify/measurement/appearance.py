"""Tell which spots may be LEDs, and which of these are whole, by each LED's last appearance.

What is far dimmer than any LED is none. An LED that has become smaller while the others have not
is hidden in part: of a small one before a textured room, half a disc looks like a narrower spot,
and its centre is off by about as much as its width has lost,

    hidden by h along one side: centre moved by h / 2, mean width less by h / 2

Widths are compared as far as they have changed alike: an arm that slows down leaves shorter trails.
Each LED is remembered for either picture, as its brightness and width fade.
"""

from dataclasses import dataclass, replace

import numpy as np

from verify.core.records import Array, Index, Spots, take_rows
from verify.measurement.alignment import RawSightings

# Standard uncertainty of a spot that may be an LED. Texture of a room gives blobs of 1 to 4 px,
# which fit wherever an LED may be; a limit of 1 px loses LEDs of which half is hidden.
MAX_VAGUE_PX = 1.4
# Of the dimmest LED's peak when last seen: the room's texture is dimmer, half an LED is not.
MIN_PEAK_SHARE = 0.3
PEAK_FADING = 0.95  # a pair, of an LED that is not seen: it may turn away meanwhile
SENSOR_LIMIT_DN = 255.0  # beyond it a peak is extrapolated
# Of an LED's width when last seen, as far as all have changed. Of whole LEDs one in a thousand is
# below, before the strongest texture two in a hundred; of half ones nearly all are.
MIN_WIDTH_SHARE = 0.87
WIDTH_FADING = 0.99  # a pair: a third of a second behind a stalk is remembered


def likely_spots(spots: Spots, least: float) -> Spots:
    """Leave out the spots whose place is hardly known, and those far dimmer than any LED.

    `least`, DN: an LED's least peak; nan: not known.
    """
    most, along_x, along_y = MAX_VAGUE_PX**2, spots.covariance[:, 0, 0], spots.covariance[:, 1, 1]
    sure = (along_x <= most) & (along_y <= most) & ~(spots.peak < least)
    return spots if np.count_nonzero(sure) == len(spots) else take_rows(spots, sure)


@dataclass(frozen=True, slots=True)
class Appearance:
    """Of n LEDs in the left picture and the right one; nan: not seen yet."""

    peak: Array  # (2, n), DN, faded since
    width: Array  # (2, n), px, full width at half height, faded since

    @classmethod
    def unknown(cls, leds: int) -> "Appearance":
        """Of LEDs that were never seen."""
        return cls(np.full((2, leds), np.nan), np.full((2, leds), np.nan))

    @property
    def least_peaks(self) -> Array:
        """Peak of what may be an LED in either picture, (2,), DN; nan: not known."""
        return np.asarray(MIN_PEAK_SHARE * self.peak.min(axis=1))

    def after(self, raw: RawSightings) -> "Appearance":
        """The appearance once a pair's LEDs are seen."""
        peak, width, at = PEAK_FADING * self.peak, WIDTH_FADING * self.width, self._places(raw)
        peak.flat[at] = np.minimum(raw.peak, SENSOR_LIMIT_DN)
        width.flat[at] = np.fmax(width.flat[at], np.where(raw.merged, np.nan, raw.width))
        return Appearance(peak, width)

    def widen_hidden(self, raw: RawSightings) -> RawSightings:
        """Widen the covariance of LEDs that have become smaller by how far they may be off."""
        before, moved = self.width.flat[self._places(raw)], np.zeros(len(raw))
        share = raw.width / before
        for own in raw.sides:
            usual = min(float(np.fmax.reduce(share[own], initial=0.0)), 1.0)
            hidden = (share[own] < MIN_WIDTH_SHARE * usual) & ~raw.merged[own]
            if np.count_nonzero(hidden):
                moved[own] = np.where(hidden, usual * before[own] - raw.width[own], 0.0)
        if not np.count_nonzero(moved):
            return raw
        wider = raw.covariance + np.square(moved)[:, None, None] * np.eye(2)
        return replace(raw, covariance=wider)

    def _places(self, raw: RawSightings) -> Index:
        """Where a pair's LEDs stand, (s,), in the flattened arrays."""
        at = raw.led.copy()
        at[raw.left :] += self.peak.shape[1]
        return at
