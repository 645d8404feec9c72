"""The pixels of each patch as a spot's parameters would have them, and what they say of these.

A pixel is mu + noise, rounded and clipped to 0 … 255, with mu = floor + slope · d + peak · f(t).
Its mean and variance after clipping have closed forms, and (observed - mean) / variance, led
through the mean's derivative, is the quasi-score. Weights come from the model, never from the
observed value: that would favour pixels whose noise happened to be low. A pixel deep in saturation
or below black has a mean that no parameter moves; it carries no information and needs no mask.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from verify.detection import kernel, kernel_pixels, kernel_priors
from verify.detection.kernel_pixels import FLOOR, PARAMETERS, PEAK, STEEPNESS, XX, YY
from verify.detection.profile import profile_table
from verify.records import Array, Noise

START_STEEPNESS = np.log(2.2)  # between a Gaussian (1.39) and an in-focus LED (5)
# Priors, standard deviations. All but the slopes' concern terms that are even about the centre and
# leave it alone; they only keep a dim or a fully saturated spot from drifting off.
PRIOR_STEEPNESS = 1.0
PRIOR_PEAK = 2000.0  # DN: eight times the sensor's range
PRIOR_FLOOR = 10.0  # DN: a floor below black is not seen
PRIOR_SHAPE = 2.0  # of (half-width / start)^-2


def _usual() -> tuple[Array, Array]:
    """Mean and inverse variance of what every spot is expected to have, (10,) each."""
    mean, weight = np.zeros(PARAMETERS), np.zeros(PARAMETERS)
    mean[STEEPNESS], mean[XX], mean[YY] = START_STEEPNESS, 1.0, 1.0
    weight[PEAK], weight[FLOOR] = PRIOR_PEAK**-2, PRIOR_FLOOR**-2
    weight[STEEPNESS], weight[XX : YY + 1] = PRIOR_STEEPNESS**-2, PRIOR_SHAPE**-2
    return mean, weight


USUAL = _usual()


@dataclass(frozen=True, slots=True)
class Patches:
    """Pixels around candidates, as many for each, with what is known of their noise."""

    # (n, 4, p): value, DN; 1 where inside the image and not clipped in part; column and row, px
    # from the cut-out's centre pixel
    pixels: Array
    scale: Array  # (n,), px, half-width that the fit starts from
    read_share: Array  # (n,), by which combining colours changes a channel's read variance
    gain_share: Array  # (n,), likewise its shot-noise gain
    noise: Noise  # of one channel

    @property
    def value(self) -> Array:
        """DN, (n, p)."""
        return self.pixels[:, 0]

    def taken(self, which: NDArray[np.intp]) -> "Patches":
        """Some of the patches."""
        return replace(
            self,
            pixels=self.pixels[which],
            scale=self.scale[which],
            read_share=self.read_share[which],
            gain_share=self.gain_share[which],
        )


@dataclass(frozen=True, slots=True)
class Priors:
    """How firmly each parameter is held, and where; and where the fit starts."""

    mean: Array  # (n, 10)
    weight: Array  # (n, 10), inverse variance
    start: Array  # (n, 10), as the pixels suggest
    saturated: NDArray[np.bool_]  # (n,), whether some pixels on the spot are at the sensor's limit

    def taken(self, which: NDArray[np.intp]) -> "Priors":
        """Those of some of the patches."""
        return Priors(
            self.mean[which], self.weight[which], self.start[which], self.saturated[which]
        )


@dataclass(frozen=True, slots=True)
class Fit:
    """Parameters of each patch's spot and the state of the pixels at them."""

    parameters: Array  # (n, 10), x and y in px from the cut-out's centre pixel
    information: Array  # (n, 10, 10), inverse covariance, priors included
    gradient: Array  # (n, 10), of the quasi-likelihood
    known: Array  # (n, 10, p), of the pixels before the last small step, but for their means
    whitened: Array  # (n, 11, p), derivatives of mu by the parameters and residuals, over sigma
    chi2: Array  # (n,)
    priors: Priors

    def put(
        self, which: NDArray[np.intp], other: "Fit", whose: NDArray[np.intp] | None = None
    ) -> None:
        """Put another fit's patches, all or some, in the place of these; priors stay."""
        for mine, theirs in zip(self.state, other.state, strict=True):
            mine[which] = theirs if whose is None else theirs[whose]

    @property
    def state(self) -> tuple[Array, ...]:
        """All that a fit changes."""
        return (
            self.parameters, self.information, self.gradient, self.known, self.whitened, self.chi2
        )  # fmt: skip


def expected(patches: Patches) -> Priors:
    """Say what is expected of each patch's spot before it is fitted."""
    n = len(patches.scale)
    mean, weight, start = np.empty((3, n, PARAMETERS))
    full = np.empty(n, dtype=np.bool_)
    kernel_priors.expect_all(
        patches.pixels, patches.scale, patches.noise.read, USUAL, (mean, weight), start, full
    )
    return Priors(mean, weight, start, full)


def solve(
    patches: Patches,
    start: Array,
    priors: Priors,
    steps: int = 0,
    settled: float = 0.0,
) -> Fit:
    """Fit every patch by Gauss-Newton.

    Args:
        patches: n of them.
        start: (n, 10), parameters to begin with.
        priors: how firmly they are held.
        steps: at most; 0 looks how the pixels stand at the start.
        settled: of chi² that a step may still gain.
    """
    n, _, size = patches.pixels.shape
    fit = Fit(
        parameters=start.copy(),
        information=np.empty((n, PARAMETERS, PARAMETERS)),
        gradient=np.empty((n, PARAMETERS)),
        known=np.empty((n, kernel_pixels.KNOWN, size)),
        whitened=np.empty((n, kernel_pixels.WHITENED, size)),
        chi2=np.empty(n),
        priors=priors,
    )
    go_on(patches, fit, patches.noise, steps, settled)
    return fit


def go_on(patches: Patches, fit: Fit, noise: Noise, steps: int, settled: float = 0.0) -> None:
    """Take a fit further where it stands, under that noise of a channel; see `solve`."""
    kernel.descend_all(
        fit.parameters, patches.pixels, patches.scale, (patches.read_share, patches.gain_share),
        (noise.read**2, noise.gain, noise.black), profile_table(),
        (fit.priors.mean, fit.priors.weight), (steps, settled),
        (fit.known, fit.whitened, fit.information, fit.gradient, fit.chi2),
    )  # fmt: skip
