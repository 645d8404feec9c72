"""The Monte-Carlo check of the budget: where linear propagation holds, and where it does not."""

from typing import Any

import numpy as np

from reports.blocks import Block, Paragraph, Table, row
from reports.formatting import count, finite, joined, number, percent, word

MOST = 12  # pairs that are listed; summary.json names all
LISTED = (
    "Listed where they may differ by more than {within} (a hundredth is left to the draws' own "
    "chance), or where the mean moves by a tenth of the standard deviation."
)


def drawn(summary: dict[str, Any]) -> list[Block]:
    """Say how the budget compares with drawing the whole chain anew."""
    check = (summary.get("budget") or {}).get("monte_carlo")
    if not check:
        return []
    entries = [e for e in check.get("joints") or [] if e.get("pairs")]
    away = [
        finite(e.get("largest_difference")) for e in entries if e.get("pairs") == e.get("holds")
    ]
    largest = max((a for a in away if a is not None), default=None)
    chain = (
        f"Monte Carlo: {count(check.get('pairs'))} pairs drawn anew {count(check.get('draws'))} "
        "times through the whole chain, pose fit and the arm's inverse included."
    )
    fails = check.get("fails") or []
    within = percent(check.get("agrees_within"))
    if not fails:
        holds = (
            "The standard deviation of every joint's error agrees with linear propagation; the "
            f"largest difference is {percent(largest)}, where {within} are allowed."
        )
        return [Paragraph(f"{chain} {holds}")]
    bad = sorted({j for fail in fails if not fail.get("coupled") for j in fail.get("joints") or []})
    counted = (
        f"It does not hold for {_joints(bad)} at the poses below: there the budget says too "
        "little or too much."
        if bad
        else "It fails only for joints that a singularity couples, which no single joint's figure "
        "rests on."
    )
    return [Paragraph(f"{chain} {counted}"), _table(fails, within)]


def _joints(names: list[Any]) -> str:
    return f"joint{'s' if len(names) > 1 else ''} {joined([word(n) for n in names])}"


def _table(fails: list[dict[str, Any]], within: str) -> Table:
    def gap(fail: dict[str, Any]) -> float:
        ratios = [finite(r) for r in fail.get("ratio") or []]
        return max((abs(np.log(r)) for r in ratios if r), default=np.inf)

    worst = sorted(fails, key=gap, reverse=True)[:MOST]
    rows = []
    for fail in sorted(worst, key=lambda f: f.get("frame") or 0):
        ratios = fail.get("ratio") or []
        said = ", ".join(
            f"q{word(j)} {number(r, 2)}"
            for j, r in zip(fail.get("joints") or [], ratios, strict=False)
        )
        rows.append(row(count(fail.get("frame")), said, _why(fail)))
    return Table(
        "Where linear propagation does not hold: drawn over linear standard deviation.",
        "rll",
        ("Pair", "Ratio by joint", "Why"),
        tuple(rows),
        (LISTED.format(within=within),),
        wide=(1,),
    )


def _why(fail: dict[str, Any]) -> str:
    if finite(fail.get("unreachable")):
        return "the arm cannot stand in some of the drawn poses"
    if fail.get("coupled"):
        return "near a singularity; these joints are left out of single figures"
    return "the arm's inverse bends within the uncertainty"
