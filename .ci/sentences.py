"""Prints a drawn sample of the sentences of this repository, for a reader who has not seen them.

    python .ci/sentences.py --seed 1 --count 200

Each line is a place and a sentence: of docstrings, of comments, of errors and other texts of Python, of doc comments and
comments of Rust, of the pages. The reader marks what is not understood at first reading; that is rewritten, with its like.
"""

from __future__ import annotations

import argparse
import ast
import io
import random
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[1]
LEAST_WORDS = 5
END = re.compile(r"(?<=[.!?;])\s+(?=[A-Z`\"])")
UNDERLINE = re.compile(r"^\s*[-=]{3,}\s*$")

Text = tuple[Path, int, str]


def of_python(path: Path) -> Iterator[Text]:
    """Yield docstrings, runs of comments, and the texts of errors."""
    source = path.read_text(encoding="utf-8")
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            for part in re.split(r"\n\s*\n|\n(?=\s*\w[\w, ]*\n\s+\S)", node.value.value):
                if "-----" not in part and ">>>" not in part:
                    yield path, node.lineno, part
        elif isinstance(node, ast.Raise) and node.exc is not None:
            parts = list(ast.walk(node.exc))
            specs = [part.format_spec for part in parts if isinstance(part, ast.FormattedValue)]
            pieces = [
                piece.value if isinstance(piece, ast.Constant) else "..."
                for part in parts
                if isinstance(part, ast.JoinedStr) and part not in specs
                for piece in part.values
            ]
            yield path, node.lineno, "".join(map(str, pieces))
    run: list[str] = []
    begin, last = 0, -1
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT or "noqa" in token.string:
            continue
        alone = token.line.lstrip().startswith("#")
        if run and not (alone and token.start[0] == last + 1):
            yield path, begin, " ".join(run)
            run = []
        begin = begin if run else token.start[0]
        run.append(token.string.lstrip("# "))
        last = token.start[0] if alone else -1
    if run:
        yield path, begin, " ".join(run)


def of_rust(path: Path) -> Iterator[Text]:
    """Yield runs of comment lines."""
    run: list[str] = []
    for number, line in enumerate([*path.read_text(encoding="utf-8").splitlines(), ""], 1):
        found = re.match(r"\s*//[/!]?\s?(.*)", line)
        if found and found[1].strip():
            run.append(found[1])
        elif run:
            yield path, number - len(run), " ".join(run)
            run = []


def of_page(path: Path) -> Iterator[Text]:
    """Yield paragraphs and items of Markdown, without code and tables."""
    text = re.sub(
        r"```.*?```|~~~.*?~~~",
        lambda code: "\n" * code[0].count("\n"),
        path.read_text(encoding="utf-8"),
        flags=re.S,
    )
    number = 1
    for part in re.split(r"(\n\s*\n|\n(?=[-*] ))", text):
        if part.strip() and not part.lstrip().startswith(("|", "#", ":", "<", "{", "(")):
            yield path, number, part
        number += part.count("\n")


def sentences() -> list[tuple[str, str]]:
    """Return place and text of every sentence."""
    readers = {
        ROOT / "python": ("*.py", of_python),
        ROOT / "rust" / "src": ("*.rs", of_rust),
        ROOT / "docs": ("*.md", of_page),
    }
    found: dict[str, str] = {}
    for folder, (pattern, read) in readers.items():
        for path in sorted(folder.rglob(pattern)):
            for file, line, text in read(path):
                lines = [one.strip() for one in text.splitlines() if not UNDERLINE.match(one)]
                for sentence in END.split(" ".join(lines).strip()):
                    if len(re.findall(r"[A-Za-z]{2,}", sentence)) >= LEAST_WORDS:
                        found.setdefault(sentence, f"{file.relative_to(ROOT)}:{line}")
    return [(place, sentence) for sentence, place in found.items()]


def main() -> None:
    """Print the sample."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=200)
    options = parser.parse_args()
    every = sentences()
    drawn = random.Random(options.seed).sample(every, min(options.count, len(every)))
    print(f"{len(drawn)} of {len(every)} sentences, seed {options.seed}")
    for number, (place, sentence) in enumerate(drawn, 1):
        print(f"{number:3} {place}: {sentence}")


if __name__ == "__main__":
    main()
