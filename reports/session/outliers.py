"""Outlying visits and pairs of repeated poses, in sentences: of the report, and as warnings."""

from typing import Any

from reports.document import formatting as fmt

MAX_NAMED = 5  # pairs in a sentence


def outlier_notes(entry: dict[str, Any] | None) -> list[str]:
    """Name visits and pairs of `performance` that lie far off the others, and RP without them."""
    if not entry:
        return []
    rp = {p["pose"]: p.get("rp_mm") for p in entry.get("poses") or []}
    notes = [
        f"Outlying among the visits of {o['pose']}: {_listed(o['visits'])} (pairs "
        f"{_listed(o['pairs'])}), up to {fmt.quantity(o.get('off_mm'), 'mm')}"
        f"{_turned(o.get('off_deg'))} off the others. AP and "
        f"RP = {fmt.quantity(rp.get(o['pose']), 'mm')} rest on them; without them RP = "
        f"{fmt.quantity(o.get('rp_without_mm'), 'mm')}. Nothing shows whether the instrument or "
        "the arm was off: check both there before either is quoted."
        for o in entry.get("outlying_visits") or []
    ]
    if pairs := entry.get("pairs_left_out"):
        notes.append(
            "Left out of repeated poses, as they lie far off the others of their hold while the "
            f"readings stand: pairs {_listed(pairs)}."
        )
    return notes


def _listed(numbers: list[int]) -> str:
    more = f" and {len(numbers) - MAX_NAMED} more" * (len(numbers) > MAX_NAMED)
    return ", ".join(map(str, numbers[:MAX_NAMED])) + more


def _turned(degrees: float | None) -> str:
    return "" if degrees is None else f" and {fmt.quantity(degrees, '°')}"
