"""A document's parts, as tests look them up."""

from reports.document.blocks import Document, Table


def tables(of: Document) -> dict[str, Table]:
    """Its tables by their captions."""
    return {
        block.caption: block
        for section in of.sections
        for block in section.blocks
        if isinstance(block, Table)
    }
