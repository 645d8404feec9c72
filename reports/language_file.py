"""Language files: TOML that maps English sentences to those of another language."""

import re
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from reports.errors import ReportError
from reports.language import ENGLISH, PLACEHOLDER, Language, Sentence

SHIPPED = Path(__file__).with_name("languages")


def language(name: str) -> Language:
    """Read a language by the name of one that ships, or by a file of the user's own.

    Args:
        name: "en", "de", or the path of a TOML file (docs/reports.md says what is in one).

    Raises:
        ReportError: no such language or file, or one that cannot be used.
    """
    if name.endswith(".toml"):
        return _read(Path(name))
    if name == "en":
        return ENGLISH
    known = ["en", *sorted(path.stem for path in SHIPPED.glob("*.toml"))]
    if name not in known:
        raise ReportError(
            "--language", f'there is no "{name}"', f"{', '.join(known)} ship, or FILE.toml",
            "docs/reports.md says how to write a language file.",
        )  # fmt: skip
    return _shipped(name)


@cache
def _shipped(name: str) -> Language:
    return _read(SHIPPED / f"{name}.toml")


def _read(path: Path) -> Language:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise _unfit(path, f"cannot be read ({problem.strerror})") from None
    except UnicodeDecodeError:
        raise _unfit(path, "is no text in UTF-8") from None
    except (tomllib.TOMLDecodeError, RecursionError) as problem:
        raise _unfit(path, f"is no TOML ({problem})") from None
    return _checked(path, table)


def _checked(path: Path, table: dict[str, Any]) -> Language:
    code, kept, names = table.pop("code", None), table.pop("keep", []), table.pop("names", [])
    if not isinstance(code, str) or not re.fullmatch(r"[A-Za-z]{2,3}(-[A-Za-z0-9]+)*", code):
        raise _unfit(f"{path}, code", f"is {code!r}", 'a language\'s code, like "de"')
    for key, words in (("keep", kept), ("names", names)):
        if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
            raise _unfit(f"{path}, {key}", "is no list of words", '["like", "this"]')
    own: dict[str, dict[str, str]] = {"page": {}, "plot": {}}
    fixed: dict[str, str] = {}
    sentences = []
    for section, texts in table.items():
        if not isinstance(texts, dict):
            raise _unfit(f"{path}, {section}", "is no table", '[table] of "English" = "other"')
        for english, other in texts.items():
            place = f'{path}, [{section}] "{_short(english)}"'
            if not isinstance(other, str):
                raise _unfit(place, "is no text", '"English sentence" = "the same, translated"')
            if section in own:
                own[section][english] = other
            elif PLACEHOLDER.search(english):
                sentences.append(_sentence(place, english, other))
            else:
                fixed[english] = other
    heaviest_first = sorted(sentences, key=lambda one: -one.weight)
    return Language(
        code,
        fixed,
        tuple(heaviest_first),
        frozenset(kept),
        frozenset(names),
        own["page"],
        own["plot"],
    )


def _sentence(place: str, english: str, other: str) -> Sentence:
    parts = PLACEHOLDER.split(english)  # literal, name, kind or None, literal, …
    literals, names = tuple(parts[::3]), tuple(parts[1::3])
    unknown = set(PLACEHOLDER.sub(r"{\1}", other).split("{")[1:])
    used = {match[1] for match in PLACEHOLDER.finditer(other)}
    if used - set(names) or len(unknown) > len(PLACEHOLDER.findall(other)):
        wrong = ", ".join(sorted(used - set(names))) or "an open brace"
        raise _unfit(place, f"its translation has {wrong}", f"placeholders {', '.join(names)}")
    if len(set(names)) < len(names) or "" in literals[1:-1]:
        raise _unfit(place, "has placeholders that cannot be told apart", "words between them")
    if not any(literals):
        raise _unfit(place, "is a placeholder alone", "words beside it")
    kinds = tuple(kind or "" for kind in parts[2::3])
    return Sentence(literals, names, kinds, other)


def _unfit(place: str | Path, found: str, expected: str = "a language file") -> ReportError:
    return ReportError(place, found, f"expected: {expected}", "docs/reports.md says how one looks.")


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:39]}…"
