"""Format numbers to the digits that are known, a dash for none; words and units as text."""

import math
from numbers import Real
from typing import Any

DASH = "–"
MINUS = "−"
COVERAGE_FACTOR = 2.0  # of the uncertainties that a person reads


def finite(value: Any) -> float | None:
    """Take a finite number; anything else, NaN and text included, is None."""
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        return None
    return float(value)


def expanded(u: Any) -> float | None:
    """Expand a standard uncertainty by k = 2; None where there is none."""
    figure = finite(u)
    return None if figure is None else COVERAGE_FACTOR * figure


def coverage_text(*factors: Any) -> str:
    """Say the coverage factors of some uncertainties: k = 2, or k = 2 to 2.19; not known: k = 2."""
    known = [figure for factor in factors if (figure := finite(factor)) is not None]
    ends = min(known, default=COVERAGE_FACTOR), max(known, default=COVERAGE_FACTOR)
    return f"k = {' to '.join(dict.fromkeys(exact_number(round(k, 2)) for k in ends))}"


def decimals_of(uncertainty: float | None) -> int:
    """Count the decimals that show an uncertainty's two significant digits (GUM 7.2.6)."""
    if not uncertainty:
        return 3  # a thousandth of a degree or millimetre: below what the instrument resolves
    rounded = float(f"{abs(uncertainty):.1e}")
    return min(max(1 - math.floor(math.log10(rounded)), 0), 7)  # 0.1 µm, 0.1 µs: no finer


def number(value: Any, decimals: int = 3, signed: bool = False) -> str:
    """Write a number with fixed decimals; a dash where there is none."""
    figure = finite(value)
    if figure is None:
        return DASH
    text = f"{figure:+z.{decimals}f}" if signed else f"{figure:z.{decimals}f}"
    if float(text) == 0:
        text = text.lstrip("+")
    return text.replace("-", MINUS)


def significant(value: Any, digits: int = 2) -> str:
    """Write a number to significant digits, without exponents; a dash where there is none."""
    figure = finite(value)
    if figure is None:
        return DASH
    if figure == 0:
        return "0"
    rounded = float(f"{figure:.{digits - 1}e}")
    decimals = min(max(digits - 1 - math.floor(math.log10(abs(rounded))), 0), 9)
    return f"{rounded:z.{decimals}f}".replace("-", MINUS)


def with_uncertainty(value: Any, uncertainty: Any, unit: str = "", signed: bool = True) -> str:
    """Write `value ± uncertainty` to the latter's two digits; degrees close up, other units not.

    An uncertainty that is 0 to the last decimal is none that anybody knows: it is not written.
    """
    figure, spread = finite(value), finite(uncertainty)
    suffix = unit if unit in ("", "°") else f" {unit}"
    if figure is None:
        return DASH
    decimals = decimals_of(spread)
    head = number(figure, decimals, signed)
    tail = number(spread, decimals)
    if spread is None or float(tail) == 0:
        return f"{head}{suffix}"
    return f"{head}{suffix} ± {tail}{suffix}" if suffix == "°" else f"{head} ± {tail}{suffix}"


def quantity(value: Any, unit: str, digits: int = 2) -> str:
    """Write a number to significant digits with its unit; a dash where there is none."""
    text = significant(value, digits)
    if text == DASH:
        return text
    return f"{text}{unit}" if unit in ("°", "") else f"{text} {unit}"


def exact_number(value: Any) -> str:
    """Write a number that somebody chose (a tolerance, a threshold), as they chose it."""
    figure = finite(value)
    return DASH if figure is None else f"{figure:z.6g}".replace("-", MINUS)


def probability(value: Any) -> str:
    """Write a probability with three decimals, never rounded up to certainty."""
    figure = finite(value)
    if figure is None:
        return DASH
    if figure > 0.9995:
        return "> 0.999"
    return "< 0.001" if figure < 0.0005 else f"{figure:.3f}"


def percent(value: Any) -> str:
    """Write a share as whole percent; near none and near all keep a digit, never rounded away."""
    figure = finite(value)
    if figure is None:
        return DASH
    share = 100 * figure
    if 99.95 <= share < 100:
        return "> 99.9 %"
    text = f"{share:z.1f}" if 0 < abs(share) < 9.95 or 99 < share < 100 else f"{share:z.0f}"
    return f"{text.replace('-', MINUS)} %"


def count(value: Any) -> str:
    """Write a whole number, thousands apart; a dash where there is none."""
    figure = finite(value)
    return DASH if figure is None else f"{figure:z,.0f}".replace(",", "\u202f")  # narrow space


def text_or_dash(value: Any) -> str:
    """Take a text as it is; a dash where there is none: a table has NaN there."""
    return DASH if value is None or value == "" or value != value else str(value)


def join_words(words: list[str]) -> str:
    """Join words as a sentence does: a, b and c."""
    return "".join(words) if len(words) < 2 else f"{', '.join(words[:-1])} and {words[-1]}"


def capitalise(sentence: str) -> str:
    """Start a sentence with a capital, without touching the rest."""
    return sentence[:1].upper() + sentence[1:]


def joint_names(numbers: list[Any], capital: bool = False) -> str:
    """Name joints in a sentence: joint 3, joints 1 and 6."""
    name = "Joint" if capital else "joint"
    plural = "s" if len(numbers) > 1 else ""
    return f"{name}{plural} {join_words([text_or_dash(n) for n in numbers])}"


NOT_STATED = "not stated"  # by whoever made the session: a dash would read as lost
UNITS = {
    "deg": "°", "ratio": "", "s": "s", "mm": "mm", "m": "m", "rad": "rad",
    "deg/m": "°/m", "deg/h": "°/h", "ppm": "ppm",
}  # fmt: skip


def lookup_label(words: dict[str, str], word: Any) -> str:
    """Look a machine word up; one that is not known is shown as it is, without underscores."""
    text = text_or_dash(word)
    return words.get(text, text.replace("_", " "))
