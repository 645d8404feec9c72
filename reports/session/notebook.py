"""What a notebook shows of a session's results: verdict, joints, conditions."""

from html import escape
from typing import Any

from reports.document import formatting as fmt
from reports.document.charts import records
from reports.results import Results
from reports.session import phrases
from reports.session.headline import headline

HEAD = ("joint", "error ± U", "largest error ± U", "tolerance", "verdict")


def fragment(results: Results, joints: Any) -> str:
    """Write it as HTML; `joints` is the table of `verify.io.results.Results.joints`."""
    verdict = headline(results)
    lines = [_row("th", HEAD), *(_row("td", _cells(one)) for one in records(joints.reset_index()))]
    conditions = "".join(f"<br><small>{escape(text)}</small>" for text in verdict.remarks)
    factors = phrases.coverage(results.summary["joints"])
    return (
        f"<p><strong>{escape(verdict.label)}:</strong> {escape(verdict.sentence)}</p>"
        f"<table>{''.join(lines)}</table>"
        f"<p><small>Errors: reading less true angle. {factors}.</small>{conditions}</p>"
    )


def _cells(joint: dict[str, Any]) -> tuple[str, ...]:
    mean, worst = (
        fmt.with_uncertainty(joint[error], joint[u], "°")
        for error, u in (
            ("mean_error_deg", "expanded_uncertainty_deg"),
            ("worst_error_deg", "worst_error_expanded_uncertainty_deg"),
        )
    )
    tolerance = fmt.finite(joint["tolerance_deg"])
    limit = "" if tolerance is None else f"±{tolerance:g}°"
    return str(joint["joint"]), mean, worst, limit, phrases.VERDICTS.get(joint["verdict"], "")


def _row(tag: str, cells: tuple[str, ...]) -> str:
    return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"
