"""Rules for texts: how sentences begin, and the map of packages."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("src", "tests", "docs", "scripts", "examples", "integrations")
KEPT = (
    "dataset/recipe/schema.py",  # Its texts are in the files of published recipes,
    "dataset/rendered/keyframes.py",  # or of rendered ones.
    "planners/prompts.py",  # Its words have a version, which results name.
    "models/cliport/model.py",  # The title of a paper.
)
CLAUSE = re.compile(
    r"(?:^[-*|>#\s]*(?:\"{3})?|[.!:)] +|\")"
    r"(?:What|Who|Whoever|Whatever|Whose) [a-z][^?]*?[.:,;\"|]",
    re.MULTILINE,
)
"""A sentence that begins with a relative clause; no question."""


def test_no_sentence_begins_with_a_relative_clause() -> None:
    files = [
        path
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in (".py", ".md", ".js", ".html")
    ]
    found = [
        f"{path.relative_to(ROOT)}: {' '.join(match[0].split())}"
        for path in (*files, ROOT / "README.md", ROOT / "CHANGELOG.md")
        if not path.as_posix().endswith(KEPT)
        for match in CLAUSE.finditer(path.read_text())
    ]
    assert found == []


def test_the_map_names_every_package() -> None:
    page = (ROOT / "docs/concepts.md").read_text()
    table = page.split("| package | holds | sub-packages |")[1].split("\n\n")[0]
    rows = [line.split("|") for line in table.splitlines()[2:]]
    told = {row[1].strip(" `"): row[3] for row in rows}
    for package in (ROOT / "src/lemma").rglob("*/__init__.py"):
        names = package.parent.relative_to(ROOT / "src/lemma").parts
        assert names[0] in told, names
        assert len(names) == 1 or f"`{names[1]}`" in told[names[0]], names
    every = {
        (package, name)
        for package, text in told.items()
        for name in re.findall(r"`(\w+)`", text)
    }
    missing = [
        pair for pair in every if not (ROOT / "src/lemma").joinpath(*pair).is_dir()
    ]
    assert missing == []
