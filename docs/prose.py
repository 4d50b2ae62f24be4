"""Check the English of the documents against the rules of docs/contributing/words.md, and the spelling of source text.

A sentence is a sentence of a paragraph or of a list item. A cell of a table has the same limit of words, but no part
in the mean. Code, formulas and link targets are left out; a name in back-ticks or a formula counts as one word.

Docstrings and comments of Python files, and comments of C files, have American spelling; names in their code may not.
"""

from __future__ import annotations

import io
import re
import tokenize
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path

LONGEST_WORDS = 30  # words of one sentence; docs/contributing/words.md
LONGEST_MEAN_WORDS = 18  # words of a page's mean sentence; docs/contributing/words.md
FEWEST_SENTENCES = 5  # sentences of a page whose mean counts; a table with two lines above it has none

BRITISH = {
    r"(?:un|dis)?colour\w*": "color",
    r"grey(?:s|ish)?": "gray",
    r"(?:milli|centi|micro|nano)?metres?": "meter",
    r"centre[sd]?": "center",
    r"neighbour\w*": "neighbor",
    r"behaviour\w*": "behavior",
    r"(?:un)?model(?:led|ling)": "modeled, modeling",
    r"(?:un)?label(?:led|ling)": "labeled, labeling",
    r"(?:minim|organ|recogn|optim|quant|normal|real|summar|initial|general|regular)is(?:e|es|ed|ing|ation|er|ers)": "-ize",
    r"analys(?:e|ed|ing)": "analyze",
    r"mould\w*|fibre\w*|calibre": "mold, fiber, caliber",
    r"licence|defence": "license, defense",
    r"whilst|amongst|learnt|spoilt|misspelt": "while, among, learned, spoiled, misspelled",
}
PRIVATE = {
    r"doubted|doubts": "low confidence",
    r"otherwise than": "differently from",
    r"comes? along": "name what is kept",
    r"mended": "fixed",
    r"dealt into": "split into",
    r"of one's own|of yours": "your",
    r"held against": "compared with",
    r"sought": "searched for",
    r"wished": "desired",
    r"(?:is|are|was|were) told": "name who says what",
    r"the whole of": "all of",
    r"begun anew|begins? anew|starts? anew": "starts again",
    r"nobody knows|nobody can tell": "is unknown",
    r"untouched images?": "background image",
    r"hereby|thereof|therein|whereof": "plain words",
}
OPENINGS = {
    r"Of (?!course)": "begin with the subject",
    r"(?:What|Whatever|Who|Whoever|Whose|How)\b": "begin with a noun: no clause as the subject",
    r"That (?!is\b|page|file|way)\w+ \w+(?:s|ed)? .*\bis\b": "begin with a noun: no clause as the subject",
}
CLAUSE = re.compile(r"[;:,] what (?:is|are|was|were|has|it|they|the|a|no)\b")
WORD = re.compile(r"[A-Za-z]+")
SOURCES = (
    "src",
    "native",
    "tests",
    "benchmarks",
    "examples",
    "docs",
    "integrations",
)  # folders with source text
NO_RULES = "docs/zh/"  # the pages in Chinese
TERMS = (
    "held-out", "training zone", "contact edge", "outlier", "confidence", "inpaint", "background image",
    "marker displacement", "forward response", "starter", "sigma", "anchor", "press folder", "color change",
)  # fmt: skip


def problems(text: str) -> list[str]:
    """Every broken rule on one page, each with a better wording.

    Parameters
    ----------
    text : str
        A page in Markdown.
    """
    found = []
    for sentence in (*sentences(text), *cells(text)):
        words = len(sentence.split())
        begin = " ".join(sentence.split()[:6])
        if words > LONGEST_WORDS:
            found.append(f"{words} words, at most {LONGEST_WORDS}: {begin} ...")
        if not sentence.endswith("?"):
            found += [f"{why}: {begin} ..." for rule, why in OPENINGS.items() if re.match(rule, sentence)]
            found += [f"a clause for a noun: ... {match[0]} ..." for match in CLAUSE.finditer(sentence)]
    lengths = [len(sentence.split()) for sentence in sentences(text)]
    if len(lengths) >= FEWEST_SENTENCES and sum(lengths) > LONGEST_MEAN_WORDS * len(lengths):
        found.append(f"{sum(lengths) / len(lengths):.1f} words in the mean, at most {LONGEST_MEAN_WORDS}")
    plain = bare(text)
    for rules in (BRITISH, PRIVATE):
        for rule, instead in rules.items():
            hits = re.findall(rf"\b(?:{rule})\b", plain, re.IGNORECASE)
            found += [f"{hit}: {instead}" for hit in hits]
    if "glossary.md" not in text and "# Glossary" not in text:
        used = [term for term in TERMS if re.search(rf"\b{term}", plain, re.IGNORECASE)]
        found += [f"no link to glossary.md, but the term: {used[0]}"] if used else []
    return found


def prose_problems(pages: Iterable[Path], root: Path) -> list[str]:
    """Every problem of the pages that keep the rules, with the page's name."""
    named = [(page, page.relative_to(root).as_posix()) for page in pages]
    return [
        f"{name}: {problem}"
        for page, name in named
        if has_rules(name)
        for problem in problems(page.read_text(encoding="utf-8"))
    ]


def spelling_problems(root: Path) -> list[str]:
    """Every British spelling in a docstring or comment of a source file, with the file and the line."""
    files = [path for folder in SOURCES for path in sorted((root / folder).rglob("*.*"))]
    return [
        f"{path.relative_to(root).as_posix()}:{line}: {problem}"
        for path in [*sorted(root.glob("*.py")), *files]
        if path.suffix in (".py", ".c", ".h") and "_build" not in path.parts
        for line, problem in misspelled(path.read_text(encoding="utf-8"), path.suffix)
    ]


def misspelled(source: str, suffix: str) -> list[tuple[int, str]]:
    """(line, word and its American spelling) of a source file's docstrings and comments.

    Parameters
    ----------
    source : text of the file
    suffix : ".py", or that of a C file
    """
    if not any(map(_american, set(WORD.findall(source)))):
        return []
    texts, names = _python_texts(source) if suffix == ".py" else (_c_texts(source), set())
    return [
        (first + text[: word.start()].count("\n"), f"{word[0]}: {_american(word[0])}")
        for first, text in texts
        for word in WORD.finditer(re.sub(r"`[^`]*`", _blank, text))
        if _american(word[0]) and word[0] not in names
    ]


@cache
def _american(word: str) -> str:
    """The American spelling of a British word; "" for other words."""
    return next((instead for rule, instead in BRITISH.items() if re.fullmatch(rule, word, re.IGNORECASE)), "")


def _python_texts(source: str) -> tuple[list[tuple[int, str]], set[str]]:
    """(line, text) of docstrings and comments, and the names in the code."""
    texts, names, starts_line = [], set(), True
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT or (token.type == tokenize.STRING and starts_line):
            texts.append((token.start[0], token.string))
        elif token.type == tokenize.NAME:
            names.add(token.string)
        if token.type not in (tokenize.COMMENT, tokenize.NL):
            starts_line = token.type in (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT)
    return texts, names


def _c_texts(source: str) -> list[tuple[int, str]]:
    """(line, text) of the comments of a C file."""
    return [(n, line.partition("//")[2]) for n, line in enumerate(source.splitlines(), 1) if "//" in line]


def _blank(code: re.Match[str]) -> str:
    """Only the line ends of a piece of code."""
    return "\n" * code[0].count("\n")


def has_rules(name: str) -> bool:
    """Whether the rules apply to a page: not to the record of changes, nor to pages in other languages than English."""
    return name != "CHANGELOG.md" and not name.startswith(NO_RULES)


def table(pages: Iterable[Path], root: Path) -> str:
    """Sentences, their mean and longest length, the share over 30 words and the problems of each page, and of all."""
    rows, every, count = [], [], 0
    for page in pages:
        name = page.relative_to(root).as_posix()
        if not has_rules(name):
            continue
        text = page.read_text(encoding="utf-8")
        lengths = [len(sentence.split()) for sentence in sentences(text)]
        wrong = len(problems(text))
        rows.append(_row(name, lengths, wrong))
        every += lengths
        count += wrong
    head = f"{'page':36} {'sentences':>9} {'mean':>6} {'longest':>7} {'over 30':>8} {'problems':>8}"
    return "\n".join([head, *rows, _row("all", every, count)])


def _row(name: str, lengths: list[int], wrong: int) -> str:
    """One line of the table."""
    count = max(len(lengths), 1)
    over = sum(length > LONGEST_WORDS for length in lengths)
    return (
        f"{name:36} {len(lengths):9} {sum(lengths) / count:6.1f} {max(lengths, default=0):7} "
        f"{100 * over / count:7.1f}% {wrong:8}"
    )


def bare(text: str) -> str:
    """A page without code, formulas, comments and link targets."""
    text = re.sub(r"^( *)```.*?^\1```", "", text, flags=re.MULTILINE | re.DOTALL)
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"\$\$.*?\$\$", "", text, flags=re.DOTALL)
    text = re.sub(r"`[^`\n]*(?:\n[^`\n]*)?`", "CODE", text)
    text = re.sub(r"\$[^$\n]+\$", "FORMULA", text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"\*\*|(?<!\w)\*(?=\w)|(?<=[\w.])\*(?!\w)", "", text)


def sentences(text: str) -> Iterator[str]:
    """Those of paragraphs and list items."""
    for block in _blocks(text):
        yield from _split(block)


def cells(text: str) -> Iterator[str]:
    """Those of the cells of tables."""
    for line in bare(text).splitlines():
        if line.lstrip().startswith("|"):
            for cell in line.strip().strip("|").split("|"):
                yield from _split(cell)


def _blocks(text: str) -> Iterator[str]:
    """Paragraphs and list items, each in one line."""
    lines: list[str] = []
    for line in [*bare(text).splitlines(), ""]:
        item = re.match(r"\s*(?:[-*]|\d+\.) ", line)
        ends = not line.strip() or line.startswith("#") or line.lstrip().startswith("|")
        if (item or ends) and lines:
            yield " ".join(lines)
            lines = []
        if not ends:
            lines.append(line[item.end() :].strip() if item else line.strip())


def _split(block: str) -> list[str]:
    """The sentences of one line of text."""
    parts = re.split(
        r"(?<=[.!?:])[\"')]*\s+(?=[\"'(]*(?:[A-Z0-9]|gelform\b))|(?<=[.!?][\")])\s+(?=[A-Z])", block.strip()
    )
    return [part.strip() for part in parts if re.search(r"\w", part)]
