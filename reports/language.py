"""Reports in other languages: a language file says English sentences in another one.

A report is worded in English; its document is translated text by text. A language file (read by
`language_file`) maps sentences, with `{placeholders}` for what varies, to their translation. What
a placeholder stands for is translated likewise; a `{placeholder:name}` stays as it is, and so does
a `{placeholder:word}`, which is one word. Numbers stay, and a text that no sentence fits stays
English.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

from reports import blocks, charts
from reports.blocks import Document
from reports.words_said import NOT_STATED

LONGEST = 4_000  # letters of a text that is looked up; no sentence of a report comes near
DEEPEST = 8  # parts within parts
CLEARLY = 10  # letters that agree: fewer do not show that a text is that sentence
PLACEHOLDER = re.compile(r"\{(\w+)(?::(name|word))?\}")
WORD = re.compile(r"[^\W\d_]{2,}")
SENTENCE_ENDS = re.compile(r"(?<=[.!?]) (?=[A-Z])")
NAME = re.compile(
    r"\S*(?:[\d_/]|\w\.\w)\S*"
)  # what no sentence is made of: a file, an id, a number

# Words of the templates, under the name by which a template asks for them.
PAGE = {
    "to_verdict": "To the verdict",
    "sections": "Sections",
    "table": "Table",
    "figure": "Figure",
    "no_script": "This plot needs JavaScript; report.pdf holds it as well.",
    "page": "page",
    "of": "of",
    "logo": "Logo",
    "filter": "Filter",
    "filter_hint": "words, all of them",
    "rows": "rows",
}

# What is text in a document; the other fields are names, numbers and marks of a kind.
TEXTS: dict[type, tuple[str, ...]] = {
    Document: ("title", "subtitle", "footer", "sections"),
    blocks.Section: ("title", "blocks"),
    blocks.Verdict: ("label", "sentence", "remarks"),
    blocks.Paragraph: ("text",),
    blocks.Bullets: ("items",),
    blocks.Facts: ("items",),
    blocks.Table: ("caption", "head", "rows", "notes"),
    blocks.Cell: ("text",),
    blocks.Figure: ("caption", "alt", "drawing"),
    charts.Chart: ("panels",),
    charts.Panel: ("marks", "y_label", "x_label", "title", "x_ticks", "y_ticks"),
    charts.Line: ("name",),
    charts.Band: ("name",),
    charts.Level: ("name",),
    charts.Points: ("name",),
    charts.Bars: ("name",),
    charts.Cells: ("text",),
    charts.Note: ("text",),
}


@dataclass(frozen=True, slots=True)
class Sentence:
    """An English sentence with placeholders, and what it is in the other language."""

    literals: tuple[str, ...]  # around the placeholders, one more than these
    names: tuple[str, ...]
    kinds: tuple[str, ...]  # of each placeholder: "", "name" or "word"
    translation: str

    @property
    def weight(self) -> int:
        """How many letters have to agree: of two sentences that fit, the heavier is meant."""
        return sum(map(len, self.literals))

    def values(self, text: str) -> dict[str, str] | None:
        """Give what the placeholders stand for; None where the text is another sentence."""
        first, last = self.literals[0], self.literals[-1]
        start, end = len(first), len(text) - len(last)
        if end <= start or not (text.startswith(first) and text.endswith(last)):
            return None
        found = []
        for literal in self.literals[1:-1]:
            at = text.find(literal, start + 1, end)
            if at < 0:
                return None
            found.append(text[start:at])
            start = at + len(literal)
        if start >= end:
            return None
        found.append(text[start:end])
        for kind, value in zip(self.kinds, found, strict=True):
            if kind == "word" and " " in value:
                return None
        return dict(zip(self.names, found, strict=True))


@dataclass(frozen=True, slots=True)
class Said:
    """A text in the other language; `whole` where nothing of it stayed English."""

    text: str
    whole: bool


@dataclass(frozen=True)
class Language:
    """A language that reports are given in.

    Args:
        code: as in HTML's `lang`: "de".
        fixed: English texts without placeholders, and their translations.
        sentences: those with placeholders, the heaviest first.
        kept: words that both languages share.
        names: labels of facts and heads of columns over words that somebody chose, which stay.
        page: the templates' own words, which may say else than the same word in a report.
        plot: the words that plotly shows over its plots.
    """

    code: str
    fixed: dict[str, str]
    sentences: tuple[Sentence, ...] = ()
    kept: frozenset[str] = frozenset()
    names: frozenset[str] = frozenset()
    page: dict[str, str] = field(default_factory=dict)
    plot: dict[str, str] = field(default_factory=dict)
    _known: dict[tuple[str, int], Said] = field(default_factory=dict, repr=False, compare=False)

    def text(self, english: str) -> str:
        """Translate a text; what is not known stays English."""
        return self._said(english).text

    def document(self, document: Document) -> Document:
        """Translate every text of a document, those in its figures included."""
        translated: Document = self._mapped(document) if self.code != "en" else document
        return translated

    def missing(self, document: Document) -> list[str]:
        """List the texts of a document that stay English, in whole or in part; names among them."""
        every = dict.fromkeys(_texts(document, self.names))
        return [text for text in every if not self._said(text).whole]

    def page_words(self) -> dict[str, str]:
        """Give a template its own words by name."""
        return {name: self.page.get(english, english) for name, english in PAGE.items()}

    def _mapped(self, value: Any) -> Any:
        if isinstance(value, str):
            return self.text(value)
        if isinstance(value, tuple):
            return tuple(self._mapped(item) for item in value)
        if isinstance(value, charts.Path):
            lines = tuple((points, role, self.text(name)) for points, role, name in value.lines)
            return replace(value, lines=lines, labels=self._mapped(value.labels))
        names = TEXTS.get(type(value), ())
        changes = {name: self._mapped(getattr(value, name)) for name in names}
        if isinstance(value, blocks.Facts):
            changes["items"] = tuple(
                (self.text(label), said if _is_name(label, said, self.names) else self.text(said))
                for label, said in value.items
            )
        elif isinstance(value, blocks.Table):
            changes["rows"] = tuple(
                tuple(cell if head in self.names else self._mapped(cell)
                      for head, cell in zip(value.head, cells, strict=True))
                for cells in value.rows
            )  # fmt: skip
        return replace(value, **changes) if changes else value

    def _said(self, text: str, depth: int = 0) -> Said:
        if len(text) > LONGEST or depth > DEEPEST:
            return Said(text, False)
        place = text, depth  # what was cut off deep down is no answer for higher up
        if place not in self._known:
            self._known[place] = self._looked_up(text, depth)
        return self._known[place]

    def _looked_up(self, text: str, depth: int) -> Said:
        """Find the best translation: all of it by one sentence, by parts, then part of it."""
        if text in self.fixed:
            return Said(self.fixed[text], True)
        others = [word for word in text.split() if not NAME.fullmatch(word)]
        if not set(WORD.findall(" ".join(others))) - self.kept:
            return Said(text, True)
        partly = Said(text, False)
        for said in self._ways(text, depth + 1):
            if said.whole:
                return said
            if partly.text == text:
                partly = said
        return partly

    def _ways(self, text: str, depth: int) -> Iterator[Said]:
        """Try what may translate a text, the likeliest first; what is not whole may be a part."""
        by_parts = (
            self._joined(SENTENCE_ENDS.split(text), " ", depth),
            self._joined(text.split("; "), "; ", depth),
        )
        # before a sentence of the file takes two for one
        yield from (said for said in by_parts if said.whole)
        if text.endswith("."):
            said = self._said(text[:-1], depth)
            if said.whole:
                yield Said(f"{said.text}.", True)
        for sentence in self.sentences:
            values = sentence.values(text)
            if values is not None:
                said = self._filled(sentence, values, depth)
                if said.whole or sentence.weight >= CLEARLY:
                    yield said
        if text[:1].isupper():
            said = self._said(text[:1].lower() + text[1:], depth)
            if said.whole:  # else a name in it would lose its capital
                yield Said(said.text[:1].upper() + said.text[1:], True)
        yield from self._parted(text, depth)
        yield from by_parts

    def _joined(self, parts: list[str], mark: str, depth: int) -> Said:
        """Translate one part after the other; a single one is no help."""
        if len(parts) == 1:
            return Said(parts[0], False)
        said = [self._said(part, depth) for part in parts]
        return Said(mark.join(part.text for part in said), all(part.whole for part in said))

    def _filled(self, sentence: Sentence, values: dict[str, str], depth: int) -> Said:
        parts = {
            name: Said(value, True) if kind else self._said(value, depth)
            for kind, (name, value) in zip(sentence.kinds, values.items(), strict=True)
        }
        text = PLACEHOLDER.sub(lambda found: parts[found[1]].text, sentence.translation)
        return Said(text, all(part.whole for part in parts.values()))

    def _parted(self, text: str, depth: int) -> Iterator[Said]:
        """Translate what several texts were joined to: a label and a text, a list."""
        for mark in (": ", ", "):
            said = self._joined(text.split(mark), mark, depth)
            if said.whole:
                yield said
        for word in ("and", "or"):
            head, found, tail = text.rpartition(f" {word} ")
            if found:
                ends = self._said(head, depth), self._said(tail, depth)
                if all(end.whole for end in ends):
                    yield Said(f"{ends[0].text} {self.fixed.get(word, word)} {ends[1].text}", True)


ENGLISH = Language("en", {})


def _is_name(label: str, said: str, names: frozenset[str]) -> bool:
    """Tell whether somebody chose what stands beside a label; nobody chose that it is missing."""
    return label in names and said != NOT_STATED


def _texts(value: Any, names: frozenset[str]) -> Iterator[str]:
    """Give every text of a document but those under a label of `names`."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, tuple):
        for item in value:
            yield from _texts(item, names)
    elif isinstance(value, charts.Path):
        yield from (name for _, _, name in value.lines)
        yield from value.labels
    elif isinstance(value, blocks.Facts):
        for label, said in value.items:
            yield from (label,) if _is_name(label, said, names) else (label, said)
    else:
        own = TEXTS.get(type(value), ())
        if isinstance(value, blocks.Table):
            own = tuple(name for name in own if name != "rows")
            for cells in value.rows:
                pairs = zip(value.head, cells, strict=True)
                yield from (cell.text for head, cell in pairs if head not in names)
        for name in own:
            yield from _texts(getattr(value, name), names)
