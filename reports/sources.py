"""What a result was made from, in its report."""

from typing import Any

from reports.blocks import Block, Bullets, Paragraph, Table, row
from reports.formatting import DASH, word


def software(summary: dict[str, Any]) -> str:
    """Name the program that made a result, and its version."""
    tool = summary.get("tool") or {}
    return f"{tool.get('name') or 'verify'} {tool.get('version') or DASH}"


def provenance(summary: dict[str, Any]) -> tuple[Block, ...]:
    """List the files that were read and the warnings."""
    blocks: list[Block] = []
    inputs = summary.get("inputs") or {}
    if inputs:
        rows = tuple(row(word(name), word(digest)) for name, digest in inputs.items())
        blocks.append(Table("Files that were read.", "ll", ("File", "Hash"), rows, wide=(1,)))
    warnings = summary.get("warnings") or []
    if warnings:
        blocks.append(Bullets(tuple(word(warning) for warning in warnings), "warning"))
    else:
        blocks.append(Paragraph("There were no warnings."))
    return tuple(blocks)
