"""Times as a person reads them: counted from the session's first pair.

Tables and summary.json keep the cameras' clock as it was recorded: seconds since a machine was
switched on, or since 1970.
"""

from dataclasses import replace
from typing import Any

import numpy as np

from reports.document import charts
from reports.results import Results

TIMES = frozenset({"t_s", "t_start_s", "t_end_s"})  # keys of instants on the cameras' clock
FIRST_PAIR = "first_pair_t_s"  # in a summary that is counted from it: s, cameras' clock


def from_first_pair(results: Results) -> Results:
    """Count every time from the first pair; its own stays in the summary's `first_pair_t_s`.

    Results without times, and those that are counted so already, are given back as they are.
    """
    t = charts.column(results.table("frames"), "t_s")
    known = t[np.isfinite(t)]
    if not len(known) or FIRST_PAIR in results.summary:
        return results
    first = float(known[0])
    tables = {
        name: table.assign(t_s=charts.column(table, "t_s") - first) if "t_s" in table else table
        for name, table in results.tables.items()
    }
    summary = _counted(results.summary, first) | {FIRST_PAIR: first}
    return replace(results, summary=summary, tables=tables)


def _counted(value: Any, first: float) -> Any:
    if isinstance(value, list):
        return [_counted(one, first) for one in value]
    if not isinstance(value, dict):
        return value
    return {
        key: inner - first
        if key in TIMES and isinstance(inner, int | float)
        else _counted(inner, first)
        for key, inner in value.items()
    }
