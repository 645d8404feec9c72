"""Causes in words: what was found of each, what to do about it, and what would tell them apart."""

from dataclasses import dataclass
from typing import Any

from reports.document import formatting as fmt

MAX_RIVALS = 4  # named of an ambiguous cause; summary.json lists all
CAUSES = {
    "offset": "constant offset",
    "gain": "gain",
    "backlash": "backlash",
    "eccentricity": "eccentricity",
    "compliance": "compliance",
    "latency": "latency",
    "drift": "drift",
    "step": "step",
    "dh": "link parameter",
    "geometry": "links that differ from the robot file",
    "clock": "encoder clock offset",
    "clock_drift": "encoder clock drift",
    "camera_skew": "late right pictures",
    "camera_turned": "turned right camera",
    "camera_drift": "creeping camera",
    "camera_tilted": "tilted camera",
    "base_moved": "moved robot base or rig",
    "base_drift": "creeping robot base or rig",
    "led_body_slipped": "slipped LED body",
}

# what to do about a cause whose remedy needs no number
REMEDIES = {
    "gain": "check its gear ratio and counts a turn in the controller",
    "backlash": "take up the play, or approach from one side only",
    "eccentricity": "check that its encoder or gear runs true",
    "compliance": "check its gear and bearings under load",
    "drift": "warm up before measuring, and check how its encoder is fixed",
    "step": "find out what slipped, was reset or exchanged then; before and after it are to be "
    "judged apart",
    "geometry": "find them with verify identify, and judge by the corrected robot file",
    "clock_drift": "take both times from one clock, or keep sessions short",
    "camera_turned": "calibrate the rig again",
    "camera_drift": "fix both cameras (a tripod head may sag, a turning base slip), calibrate the "
    "rig and record again",
    "camera_tilted": "fix both cameras (one was touched, or its mount gave way), calibrate the rig "
    "and record again",
    "base_moved": "register the robot base again",
    "base_drift": "fix what base and cameras stand on (a tripod may sink or tilt), register the "
    "robot base and record again",
    "led_body_slipped": "fix the LED body, and measure or register it again",
}

# what no motion tells from an offset, a drift or a link's error at the first axis and at the last;
# from a base that creeps, a camera that tilts
SAME_AS = {
    "base_turned": "the robot base, turned as much about this axis,",
    "base_shifted": "the robot base, shifted as much along this axis,",
    "led_body_turned": "the LED body, turned as much about this axis,",
    "led_body_shifted": "the LED body, shifted as much,",
    "led_body_tilted": "the LED body, turned as much,",
    "camera_tilted": "the pictures contradict the rig: one camera, tilted by about twice the turn,",
}

# the motion that tells causes apart; {joints} is joint 3, or joints 3 and 4, {singly} how they move
MOTIONS = {
    "independent_registration": "find base and LED body by fixture and jig, then record again",
    "other_distances": "record again at other distances from the cameras",
    "longer_record": "record for longer",
    "return_to_start": "record for longer, and return to the first pose now and then",
    "varied_speeds": "record again at varied speeds, with stops in between",
    "two_sided_stops": "record again with stops of {joints} at one angle, reached from both sides",
    "lever_both_sides": "record again with the arm beyond {joints} stretched out, upright and back",
    "wider_swing": "record again with wider swings of {joints}",
    "other_postures": "record again in other postures, moving {joints} {singly}",
}
# Sizes beyond which an arm would not have worked: such a figure comes from a motion that hardly
# tells its causes apart.
MAX_PLAUSIBLE = {("gain", "ratio"): 0.1, ("dh", "mm"): 20.0, ("dh", "deg"): 3.0}
IMPLAUSIBLE = (
    "its figure is too large to be real, as the motion hardly tells causes apart: move all joints "
    "through their ranges, at varied speeds"
)


def cause_name(entry: dict[str, Any]) -> str:
    """Name a cause: offset of joint 3."""
    kind = str(entry.get("kind"))
    name = fmt.lookup_label(CAUSES, kind)
    if kind == "dh" and entry.get("parameter") is not None:
        name = f"{name} {entry['parameter']}"
    if kind == "eccentricity" and fmt.finite(entry.get("phase_deg")) is not None:
        name = f"{name} ({_turns(entry)} per turn, phase {fmt.number(entry['phase_deg'], 1)}°)"
    elif entry.get("per_turn_candidates"):
        name = f"{name} ({_turns(entry)} per turn)"
    joint = entry.get("joint")
    name = name if joint is None else f"{name} of joint {joint}"
    return name if fmt.finite(entry.get("t_s")) is None else f"{name} at {_seconds(entry)}"


def _seconds(entry: dict[str, Any]) -> str:
    """When a fault began, from the first pair."""
    return f"{fmt.number(entry.get('t_s'), 1)} s"


def _turns(entry: dict[str, Any]) -> str:
    """Number of waves a turn: one, or all that explain the errors alike: 38 to 40 or 80."""
    numbers = entry.get("per_turn_candidates") or [entry.get("per_turn", 1)]
    firsts = [n for n in numbers if n - 1 not in numbers]
    lasts = [n for n in numbers if n + 1 not in numbers]
    runs = zip(map(fmt.exact_number, firsts), map(fmt.exact_number, lasts), strict=True)
    return " or ".join(a if a == b else f"{a} to {b}" for a, b in runs)


def format_value(entry: dict[str, Any]) -> str:
    """Write a cause's value ± expanded uncertainty, without its unit."""
    return fmt.with_uncertainty(entry.get("value"), entry.get("expanded_uncertainty"))


def unit_sign(entry: dict[str, Any]) -> str:
    """Write a cause's unit as a sign."""
    unit = entry.get("unit")
    return "ratio" if unit == "ratio" else fmt.lookup_label(fmt.UNITS, unit)


def finding(entry: dict[str, Any]) -> str:
    """Say a cause in half a sentence, then what to do: `joint 3 reads 0.400° too high: add …`."""
    text = CAUSE_TEXTS.get(str(entry.get("kind")))
    value = fmt.finite(entry.get("value"))
    if entry.get("kind") == "geometry":  # no single figure tells it
        return f"the arm's links differ from the robot file: {remedy(entry)}"
    if value is None or text is None:
        return candidate(entry)
    return f"{_cause_sentence(text, entry, value)}: {remedy(entry)}"


def is_implausible(entry: dict[str, Any]) -> bool:
    """Tell whether a cause is larger than any that an arm could work with."""
    most = MAX_PLAUSIBLE.get((str(entry.get("kind")), str(entry.get("unit"))), float("inf"))
    return abs(fmt.finite(entry.get("value")) or 0.0) > most


def remedy(entry: dict[str, Any]) -> str:
    """Say what to do about a cause."""
    known = fmt.finite(entry.get("value"))
    kind = entry.get("kind")
    if kind == "ambiguous":
        return separation(entry)
    if kind == "geometry":
        return REMEDIES["geometry"]
    if known is None:
        return fmt.DASH
    if is_implausible(entry):
        return IMPLAUSIBLE
    change = fmt.number(-known if kind == "offset" else known, _decimals(entry), signed=True)
    same = f" ({text})" if (text := same_as(entry)) else ""
    if kind == "offset":
        return f"add {change}° to its reading{same}"
    if kind == "camera_skew":
        return f"add {change} s to t_right_s in frames.csv"
    if kind == "latency":
        return "read it at the same instant as the other joints, or correct its time stamps"
    if kind == "clock":
        return f"add {change} s to the clock offset that was given"
    if kind == "dh":
        place = f"{entry.get('parameter', 'the parameter')} in the robot file"
        return f"correct {place} by {change} {unit_sign(entry)}".strip() + same
    return REMEDIES.get(str(kind), fmt.DASH) + same


def same_as(entry: dict[str, Any]) -> str:
    """Say what shows the same as a cause, whatever the motion; empty: nothing does."""
    part = SAME_AS.get(str(entry.get("same_as")))
    return "" if part is None else f"{part} would show the same"


def separation(entry: dict[str, Any]) -> str:
    """Say the motion that would tell apart what an entry cannot."""
    motion = MOTIONS.get(str(entry.get("separating_motion")))
    numbers = entry.get("separating_joints") or []
    if motion is None or ("{joints}" in motion and not numbers):
        return "record a motion that tells these apart (verify plan proposes one)"
    singly = "alone" if len(numbers) == 1 else "one at a time"
    return motion.format(joints=fmt.joint_names(numbers), singly=singly)


def runner_up(entry: dict[str, Any]) -> str:
    """Name the rival that fits best in a cause's place, and by how much worse."""
    rival = entry.get("runner_up")
    if not isinstance(rival, dict):
        return fmt.DASH
    return f"{cause_name(rival)} (ΔBIC {fmt.number(rival.get('advantage'), 0)})"


def candidate(entry: Any) -> str:
    """Name one of the causes that the data do not tell apart."""
    if not isinstance(entry, dict):
        return str(entry)
    amount = with_expanded_uncertainty(
        entry, entry.get("value"), fmt.lookup_label(fmt.UNITS, entry.get("unit"))
    )
    return cause_name(entry) if amount == fmt.DASH else f"{cause_name(entry)}, {amount}"


def rivals(entry: dict[str, Any], between: str) -> str:
    """Name the causes that an entry cannot tell apart, the likeliest first, few of many."""
    named = [candidate(c) for c in entry.get("candidates") or []]
    more = len(named) - MAX_RIVALS
    shown = (
        named if more <= 0 else [*named[:MAX_RIVALS], f"{fmt.count(more)} other{'s' * (more > 1)}"]
    )
    return between.join(shown) or fmt.DASH


def with_expanded_uncertainty(
    entry: dict[str, Any], value: Any, unit: str, signed: bool = True, factor: float = 1.0
) -> str:
    """Write a cause's figure ± expanded uncertainty; in a sentence no head of a column says k."""
    known, spread = fmt.finite(value), fmt.finite(entry.get("expanded_uncertainty"))
    if known is None or spread is None:
        return fmt.with_uncertainty(None if known is None else factor * known, None, unit, signed)
    amount = fmt.with_uncertainty(factor * known, factor * spread, unit, signed)
    return f"{amount} ({fmt.coverage_text(coverage_factor(entry))})"


def coverage_factor(entry: dict[str, Any]) -> float | None:
    """Give the coverage factor of a cause's figure; None where it is not stated."""
    u, spread = (fmt.finite(entry.get(f"{n}_uncertainty")) for n in ("standard", "expanded"))
    return spread / u if u and spread is not None else None


def _decimals(entry: dict[str, Any]) -> int:
    text = fmt.with_uncertainty(entry.get("value"), entry.get("expanded_uncertainty")).split(" ")[0]
    return len(text.partition(".")[2])


@dataclass(frozen=True, slots=True)
class CauseText:
    """A cause as half a sentence; it may name amount, joint, turns, parameter, turn, way, since."""

    sentence: str
    unit: str = "°"
    ways: tuple[str, str] | None = None  # of a positive and of a negative value, shown unsigned
    signed: bool = False
    factor: float = 1.0  # from the entry's unit to that of the sentence
    since: str = "since it was registered"  # of what was there before the session


CAUSE_TEXTS = {
    "offset": CauseText("joint {joint} reads {amount} too {way}", ways=("high", "low")),
    "gain": CauseText(
        "joint {joint}'s reading turns {amount} {way} than the joint",
        "%",
        ways=("more", "less"),
        factor=100.0,
    ),
    "backlash": CauseText(
        "joint {joint} has {amount} of backlash, its encoder on the {way} side",
        ways=("motor's", "joint's"),
    ),
    "eccentricity": CauseText("joint {joint}'s error is a wave of {amount}, {turns} a turn"),
    "clock": CauseText("the encoder clock offset is wrong by {amount}", "s", ways=("", "")),
    "dh": CauseText("{owner}'s {parameter} differs by {amount}", "", signed=True),
    "compliance": CauseText("joint {joint} gives way by {amount} of lever", "°/m"),
    "latency": CauseText(
        "joint {joint}'s readings {way} the other joints' by {amount}", "s", ways=("lag", "lead")
    ),
    "step": CauseText("joint {joint}'s reading changed by {amount} {since}", signed=True),
    "drift": CauseText("joint {joint}'s reading drifts by {amount}", "°/h", signed=True),
    "clock_drift": CauseText("the encoder clock {way} {amount}", "ppm", ways=("loses", "gains")),
    "camera_skew": CauseText(
        "the right pictures were taken {amount} {way} than stamped", "s", ways=("later", "earlier")
    ),
    "camera_turned": CauseText(
        "the right camera has turned by {amount} {since}",
        ways=("", ""),
        since="since the calibration",
    ),
    "camera_drift": CauseText(
        "the right camera has turned by {amount} against the left one from the first pair to the "
        "last",
        signed=True,
    ),
    "camera_tilted": CauseText(
        "one of the cameras was tilted by {amount} {since}", since="in the course of the session"
    ),
    "base_moved": CauseText(
        "the robot's base, or the whole rig, has moved by {amount} and {turn}° {since}", "mm"
    ),
    "base_drift": CauseText(
        "the robot's base, or the whole rig, has crept by {amount} and {turn}° from the first pair "
        "to the last",
        "mm",
    ),
    "led_body_slipped": CauseText("the LED body has moved by {amount} and {turn}° {since}", "mm"),
}


def _cause_sentence(text: CauseText, entry: dict[str, Any], value: float) -> str:
    joint, shown, turns = entry.get("joint"), abs(value) if text.ways else value, _turns(entry)
    return text.sentence.format(
        amount=with_expanded_uncertainty(
            entry, shown, text.unit or unit_sign(entry), text.signed, text.factor
        ),
        joint=joint,
        owner="the arm" if joint is None else f"joint {joint}",
        parameter=entry.get("parameter", "a link parameter"),
        turns=f"{turns} {'wave' if turns == '1' else 'waves'}",
        turn=fmt.number(entry.get("turn_deg"), 3),
        since=text.since
        if fmt.finite(entry.get("t_s")) is None
        else f"{_seconds(entry)} after the first pair",
        way=text.ways[value <= 0] if text.ways else "",
    )
