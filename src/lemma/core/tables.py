"""Tables of words and numbers, for terminals, Markdown, LaTeX and CSV."""

import csv
import io
import re
from collections.abc import Container
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import rich.table

_SPECIAL = {
    "\\": r"\textbackslash{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "≈": r"$\approx$",
    "×": r"$\times$",
    "−": "$-$",
    "–": "--",
    "“": "``",
    "”": "''",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
}
_MARKS = (
    (re.compile(r"`([^`]+)`"), r"\\texttt{\1}"),
    (re.compile(r"\*\*([^*]+)\*\*"), r"\\textbf{\1}"),
    (re.compile(r"\*([^*]+)\*"), r"\\emph{\1}"),
)


@dataclass(frozen=True)
class Table:
    """A table with cells of text, in which Markdown marks are emphasis."""

    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    labels: int = 1
    """Number of columns from the left with words instead of numbers."""

    def markdown(self) -> str:
        """Return the table in Markdown, with numbers aligned to the right."""
        numbers = len(self.header) - self.labels
        rule = [*[":---"] * self.labels, *["---:"] * numbers]
        lines = (self.header, rule, *self.rows)
        return "".join(f"| {' | '.join(line)} |\n" for line in lines)

    def csv(self) -> str:
        """Return the table as comma-separated values, without marks."""
        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerows(map(plain, row) for row in (self.header, *self.rows))
        return text.getvalue()

    def latex(self, caption: str = "", label: str = "") -> str:
        r"""Return the table in LaTeX; it needs ``\usepackage{booktabs}``.

        Args:
            caption: Caption in plain text; none if empty.
            label: Label for ``\ref``; none if empty.
        """
        columns = "l" * self.labels + "r" * (len(self.header) - self.labels)
        lines = [
            r"\begin{table}[t]",
            r"  \centering",
            rf"  \begin{{tabular}}{{{columns}}}",
            r"    \toprule",
            f"    {_line(self.header)}",
            r"    \midrule",
            *(f"    {_line(row)}" for row in self.rows),
            r"    \bottomrule",
            r"  \end{tabular}",
        ]
        if caption:
            lines.append(rf"  \caption{{{escaped(caption)}}}")
        if label:
            lines.append(rf"  \label{{{label}}}")
        return "\n".join((*lines, r"\end{table}")) + "\n"

    def terminal(self, bold: Container[int] = ()) -> "rich.table.Table":
        """Return the table for a terminal, with numbers aligned to the right.

        Args:
            bold: Indices of bold rows.
        """
        # Late import, so that ``rich`` is needed for terminals only.
        from rich.box import SIMPLE_HEAD  # noqa: PLC0415
        from rich.table import Table as RichTable  # noqa: PLC0415
        from rich.text import Text  # noqa: PLC0415

        # Without the edge, four kinds of instructions fit into 80 columns.
        shown = RichTable(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
        for number, heading in enumerate(self.header):
            shown.add_column(
                Text(heading),
                style="bold" if number == 0 else "",
                justify="left" if number < self.labels else "right",
                # Only sentences, in the other label columns, may wrap.
                no_wrap=not 0 < number < self.labels,
            )
        for number, row in enumerate(self.rows):
            shown.add_row(*map(Text, row), style="bold" if number in bold else "")
        return shown


def plain(text: str) -> str:
    """Return a cell without Markdown marks."""
    for mark, _ in _MARKS:
        text = mark.sub(r"\1", text)
    return text


def escaped(text: str) -> str:
    """Return plain text, or a cell with Markdown marks, in LaTeX."""
    safe = "".join(_SPECIAL.get(character, character) for character in text)
    for mark, command in _MARKS:
        safe = mark.sub(command, safe)
    return safe


def _line(cells: tuple[str, ...]) -> str:
    return " & ".join(map(escaped, cells)) + r" \\"
