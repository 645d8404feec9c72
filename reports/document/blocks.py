"""The parts of a report in any format: sections, paragraphs, tables, figures; provenance."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from itertools import count
from typing import Any, ClassVar

from reports.document import formatting as fmt
from reports.document.charts import Chart, Path
from reports.results import Results, one_line

# spaces at which no line breaks: before a figure's unit, and in a coverage factor
UNBROKEN = re.compile(
    r"(?<=\d) (?=(?:mm|px|m|s|ms|rad|ppm|%|Hz|°/h|°/m)(?![\w/]))"
    r"|(?<=\bk) (?== \d)|(?<=\bk =) (?=\d)"
)


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell of a table; `tone` is a verdict's machine word where the cell shows one."""

    text: str
    tone: str = ""
    link: str = ""  # a file beside the report, on the screen alone


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict, what to do about it in one sentence, and what that rests on."""

    kind: ClassVar[str] = "verdict"
    tone: str  # conform, nonconform, undecided, none
    label: str
    sentence: str
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Paragraph:
    """Running text; `tone` is "" or "note"."""

    kind: ClassVar[str] = "paragraph"
    text: str
    tone: str = ""


@dataclass(frozen=True, slots=True)
class Bullets:
    """A list of sentences; `tone` is "" or "warning"."""

    kind: ClassVar[str] = "bullets"
    items: tuple[str, ...]
    tone: str = ""


@dataclass(frozen=True, slots=True)
class Facts:
    """Labels and what they stand for, side by side.

    An empty text is a line to be filled in; several are a list.
    """

    kind: ClassVar[str] = "facts"
    items: tuple[tuple[str, str | tuple[str, ...]], ...]
    columns: int = 1  # of labels, on paper


@dataclass(frozen=True, slots=True)
class Table:
    """A numbered table; `align` has one letter a column: l, r or c."""

    kind: ClassVar[str] = "table"
    caption: str
    align: str
    head: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    notes: tuple[str, ...] = ()
    wide: tuple[int, ...] = ()  # columns that hold sentences and take the room that is left
    number: int = 0


@dataclass(frozen=True, slots=True)
class Column:
    """A column of a table: head, alignment (l, r or c), and the cell that an entry gives."""

    head: str
    align: str
    cell: Callable[[Any], str | Cell]
    wide: bool = False  # holds sentences and takes the room that is left


@dataclass(frozen=True, slots=True)
class Figure:
    """A numbered figure: a chart, or an image that was recorded."""

    kind: ClassVar[str] = "figure"
    name: str
    caption: str
    alt: str  # what it shows, for those who cannot see it
    drawing: Chart | Path | bytes | None = None  # bytes: a PNG
    number: int = 0


@dataclass(frozen=True, slots=True)
class FigurePlan:
    """How a figure is drawn, its words, and what stands in its place where nothing is to draw."""

    draw: Callable[[Results], Chart | Path | None] | None  # None: an image that was recorded
    caption: str
    alt: str
    otherwise: str


@dataclass(frozen=True, slots=True)
class Film:
    """A film that lies beside the report; the page plays it where it holds it, paper names it."""

    kind: ClassVar[str] = "film"
    file: str  # its name beside the report
    caption: str
    drawing: bytes = b""  # an MP4; a page that would grow too large with it links to the file
    poster: str = ""  # name of the figure that is shown before it plays


Block = Verdict | Paragraph | Bullets | Facts | Table | Figure | Film


@dataclass(frozen=True, slots=True)
class Section:
    """A heading and what stands under it."""

    name: str  # the anchor in a page
    title: str
    blocks: tuple[Block, ...]
    part: str = ""  # page: a page of its own; appendix: behind all that answers


SectionMaker = Callable[[Results], Section | None]  # None: these results have nothing to show


@dataclass(frozen=True, slots=True)
class Document:
    """A whole report, in order."""

    title: str
    subtitle: str
    footer: str  # what identifies the evidence on every page
    sections: tuple[Section, ...] = ()
    sortable: bool = False  # tables sort and filter on the screen


def lay_out(
    title: str, subtitle: str, footer: str, sections: Iterable[Section], sortable: bool = False
) -> Document:
    """Make a report; tables and figures are numbered through it, so that both formats agree."""
    numbers = {Table: count(1), Figure: count(1)}

    def numbered(block: Block) -> Block:
        if isinstance(block, Table | Figure):
            return replace(block, number=next(numbers[type(block)]))
        return block

    every = (replace(s, blocks=tuple(map(numbered, s.blocks))) for s in sections)
    return Document(title, subtitle, footer, tuple(every), sortable)


def answer_and_evidence(
    results: Results, answer: Callable[[Results], Section], evidence: Iterable[SectionMaker]
) -> tuple[Section, ...]:
    """Put the answer on a page of its own, and all that it rests on into the appendix."""
    sections = (section for make in evidence if (section := make(results)) is not None)
    rest = (replace(section, part="appendix") for section in sections)
    return (replace(answer(results), part="page"), *rest)


def remedies(actions: Iterable[str], unchecked: Iterable[str]) -> Facts:
    """End page one: what to do, and what was not checked."""
    items = ("What to do", tuple(actions)), ("Not checked", tuple(unchecked))
    return Facts(
        tuple((label, t if len(t) > 1 else " ".join(t) or "nothing") for label, t in items)
    )


def collect_figures(document: Document) -> dict[str, Chart | Path | bytes]:
    """Collect what is drawn in a document, by name."""
    return {
        block.name: block.drawing
        for section in document.sections
        for block in section.blocks
        if isinstance(block, Figure) and block.drawing is not None
    }


def collect_films(document: Document) -> dict[str, bytes]:
    """Collect the films that a page holds, by their files' names."""
    return {
        block.file: block.drawing
        for section in document.sections
        for block in section.blocks
        if isinstance(block, Film) and block.drawing
    }


def to_template_data(value: Any, write: Callable[[str], str] = one_line) -> Any:
    """A document for a template: plain dicts and lists, texts on one line, kinds, no drawings."""
    if isinstance(value, str):
        return write(value)
    if isinstance(value, list | tuple):
        return [to_template_data(item, write) for item in value]
    if is_dataclass(value):
        data = {
            f.name: to_template_data(getattr(value, f.name), write)
            for f in fields(value)
            if f.name != "drawing"
        }
        return data | {"kind": kind} if (kind := getattr(value, "kind", None)) else data
    return value


def unbroken(text: str) -> str:
    """Write a text on one line that does not break between a figure and its unit."""
    return UNBROKEN.sub("\N{NO-BREAK SPACE}", one_line(text))


def block_or_paragraph(
    figure: Figure, drawing: Chart | Path | bytes | None, otherwise: str
) -> Block:
    """Show a figure where there is something to draw, else say in words why there is none."""
    return Paragraph(otherwise, "note") if drawing is None else replace(figure, drawing=drawing)


def figure_or_text(figures: Mapping[str, FigurePlan], results: Results, name: str) -> Block:
    """Show one of a report's figures, or say why it is not there."""
    plan = figures[name]
    drawing = results.images.get(name) if plan.draw is None else plan.draw(results)
    return block_or_paragraph(Figure(name, plan.caption, plan.alt), drawing, plan.otherwise)


def row(*cells: str | Cell) -> tuple[Cell, ...]:
    """Make a table row from texts."""
    return tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in cells)


def field(
    key: str, write: Callable[..., str] = fmt.text_or_dash, *arguments: Any, **options: Any
) -> Callable[[Mapping[str, Any]], str]:
    """Make the writer of one value of an entry; a missing value is written as None is."""
    return lambda entry: write(entry.get(key), *arguments, **options)


def uncertain_field(
    key: str, u_key: str, unit: str = "", *, signed: bool = True, k: float = 1.0, k_key: str = ""
) -> Callable[[Mapping[str, Any]], str]:
    """Make the writer of a value of an entry with `k` times its uncertainty.

    `k_key`: where the entry has a coverage factor of its own, which then counts instead.
    """

    def write(entry: Mapping[str, Any]) -> str:
        u, own = fmt.finite(entry.get(u_key)), fmt.finite(entry.get(k_key))
        spread = None if u is None else (own or k) * u
        return fmt.with_uncertainty(entry.get(key), spread, unit, signed)

    return write


def expanded_field(key: str) -> Callable[[Mapping[str, Any]], str]:
    """Make the writer of an entry's standard uncertainty as U, k = 2, to two digits."""
    return lambda entry: fmt.significant(fmt.expanded(entry.get(key)))


def tabulate(caption: str, columns: Iterable[Column], entries: Iterable[Any], *notes: str) -> Table:
    """Make a table with a row an entry; `notes` stand under it."""
    columns = tuple(columns)
    return Table(
        caption,
        "".join(column.align for column in columns),
        tuple(column.head for column in columns),
        tuple(row(*(column.cell(entry) for column in columns)) for entry in entries),
        notes,
        tuple(place for place, column in enumerate(columns) if column.wide),
    )


def software(summary: dict[str, Any]) -> str:
    """Name the program that made a result, and its version."""
    tool = summary.get("tool") or {}
    return f"{tool.get('name') or 'verify'} {tool.get('version') or fmt.DASH}"


def described(summary: dict[str, Any], otherwise: str) -> str:
    """Give the description or the path of what a result was made from."""
    source = summary.get("source") or {}
    return fmt.text_or_dash(source.get("description") or source.get("path") or otherwise)


def decisions(summary: dict[str, Any]) -> list[Block]:
    """List what was decided on the way, where anything was."""
    every = [fmt.capitalise(fmt.text_or_dash(text)) for text in summary.get("decisions") or []]
    return [Bullets(tuple(every))] if every else []


def provenance(summary: dict[str, Any]) -> tuple[Block, ...]:
    """List the files that were read and the warnings."""
    blocks: list[Block] = []
    inputs = summary.get("inputs") or {}
    if inputs:
        rows = tuple(
            row(fmt.text_or_dash(name), fmt.text_or_dash(it)) for name, it in inputs.items()
        )
        blocks.append(Table("Files that were read.", "ll", ("File", "Hash"), rows, wide=(1,)))
    warnings = summary.get("warnings") or []
    if warnings:
        blocks.append(Bullets(tuple(fmt.text_or_dash(warning) for warning in warnings), "warning"))
    else:
        blocks.append(Paragraph("There were no warnings."))
    return tuple(blocks)


def files_and_software(results: Results, *facts: tuple[str, str]) -> Section:
    """Close a report with what it was made from; `facts` come first."""
    lead = Facts((*facts, ("Software", software(results.summary))))
    return Section("conditions", "Files and software", (lead, *provenance(results.summary)))
