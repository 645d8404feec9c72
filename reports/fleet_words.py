"""Words of a fleet report: states, kinds, dates, sentences."""

from datetime import UTC, datetime, timedelta
from typing import Any

import pandas as pd

from reports.formatting import count, finite, measured, stated, word

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
STATES = {
    "steady": "no change",
    "step": "stepped",
    "drift": "drifts",
    "change": "changed: step or drift",
    "several": "changed more than once",
    "unknown": "not enough sessions",
}
TONES = {"steady": "conform", "unknown": "undecided", "step": "nonconform", "drift": "nonconform",
         "change": "nonconform", "several": "nonconform"}  # fmt: skip
KINDS = {"step": "step", "drift": "drift", "change": "step or drift"}
VERDICTS = {"conform": "conform", "nonconform": "do not conform", "undecided": "undecided"}


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Take a table row by row."""
    return [{str(name): value for name, value in one.items()} for one in table.to_dict("records")]


def day(days: Any) -> str:
    """Write days since 1970 as a date."""
    known = finite(days)
    return "–" if known is None else (EPOCH + timedelta(days=known)).strftime("%Y-%m-%d")


def period(held: dict[str, Any]) -> str:
    """Say from when to when; nothing where no session has a date."""
    if not held.get("first"):
        return ""
    return f", {held['first']} to {held['last']}"


def dated(change: dict[str, Any]) -> str:
    """Date a change to its session."""
    at = day(change["t_days"])
    if change["term"] == "drift":
        return f"from {at} on"
    before = day(change["before_t_days"])
    return f"{at} (last before: {before})"


def change(one: dict[str, Any]) -> str:
    """Say a change in half a sentence."""
    unit = "°" if one["unit"] == "deg" else "° a month"
    size = measured(abs(float(one["size"])), 2 * float(one["size_u"]), signed=False)
    way = "up" if float(one["size"]) > 0 else "down"
    verb = {"step": "stepped", "drift": "drifts", "change": "changed (step or drift)"}
    when = "since" if one["term"] == "drift" else "on"
    return (
        f"joint {one['joint']} of {word(one['arm'])} {verb[str(one['kind'])]} {way} by "
        f"{size}{unit} {when} {day(one['t_days'])}"
    )


def rate(summary: dict[str, Any]) -> str:
    """State the rate of false accusations."""
    share = finite(summary.get("false_alarm"))
    percent = stated(None if share is None else 100 * share)
    return (
        f"In a fleet without any change, the chance that this report names one, in whichever of "
        f"its {count(len(summary.get('arms') or []))} arms and all their joints, is at most "
        f"{percent} %."
    )
