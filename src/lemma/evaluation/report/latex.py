"""Tables for papers: LaTeX with the rules of booktabs."""

import re

from lemma.evaluation.report.tables import ResultTable

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


def latex(table: ResultTable, caption: str = "", label: str = "") -> str:
    r"""Return a table for a paper; it needs ``\usepackage{booktabs}``.

    Args:
        table: What to write; marks of Markdown become commands.
        caption: Below the table, if any; plain text.
        label: What ``\ref`` calls it, if anything.
    """
    columns = "l" * table.labels + "r" * (len(table.header) - table.labels)
    lines = [
        r"\begin{table}[t]",
        r"  \centering",
        rf"  \begin{{tabular}}{{{columns}}}",
        r"    \toprule",
        f"    {_line(table.header)}",
        r"    \midrule",
        *(f"    {_line(row)}" for row in table.rows),
        r"    \bottomrule",
        r"  \end{tabular}",
    ]
    if caption:
        lines.append(rf"  \caption{{{escaped(caption)}}}")
    if label:
        lines.append(rf"  \label{{{label}}}")
    return "\n".join((*lines, r"\end{table}")) + "\n"


def escaped(text: str) -> str:
    """Return plain text, or a cell of Markdown, so that LaTeX prints it as meant."""
    safe = "".join(_SPECIAL.get(character, character) for character in text)
    for mark, command in _MARKS:
        safe = mark.sub(command, safe)
    return safe


def _line(cells: tuple[str, ...]) -> str:
    return " & ".join(map(escaped, cells)) + r" \\"
