"""Tables that can be copied into a paper."""

import io
import re

from rich.console import Console

from lemma.core.tables import Table, escaped

TABLE = Table(
    ("success [%]", "stack_2", "mean"),
    (("ET & CLIPort", "50.0 (24–76)", "60.0 ± 20.0"), ("*paper*", "≈ 27", "–")),
)


def test_a_table_has_the_rules_of_booktabs_and_all_cells() -> None:
    lines = [line.strip() for line in TABLE.latex("Success.", "tab:it").splitlines()]
    assert lines == [
        r"\begin{table}[t]",
        r"\centering",
        r"\begin{tabular}{lrr}",
        r"\toprule",
        r"success [\%] & stack\_2 & mean \\",
        r"\midrule",
        r"ET \& CLIPort & 50.0 (24--76) & 60.0 $\pm$ 20.0 \\",
        r"\emph{paper} & $\approx$ 27 & -- \\",
        r"\bottomrule",
        r"\end{tabular}",
        r"\caption{Success.}",
        r"\label{tab:it}",
        r"\end{table}",
    ]


def test_whatever_people_call_their_policies_is_safe() -> None:
    text = escaped(r"a\b{c}~d^e $5 #1 <x> 100% _")
    assert text == (
        r"a\textbackslash{}b\{c\}\textasciitilde{}d\textasciicircum{}e \$5 \#1 "
        r"\textless{}x\textgreater{} 100\% \_"
    )


def test_marks_of_markdown_become_commands() -> None:
    assert escaped("**no** and `lemma reproduce x_y`") == (
        r"\textbf{no} and \texttt{lemma reproduce x\_y}"
    )


def test_values_have_no_marks() -> None:
    assert TABLE.csv().splitlines() == [
        "success [%],stack_2,mean",
        "ET & CLIPort,50.0 (24–76),60.0 ± 20.0",
        "paper,≈ 27,–",
    ]


def test_a_terminal_shows_brackets_as_they_are() -> None:
    text = io.StringIO()
    Console(file=text, width=80).print(TABLE.terminal())
    assert "success [%]" in text.getvalue()


def test_both_forms_have_the_same_rows() -> None:
    rows = [line for line in TABLE.latex().splitlines() if line.endswith(r"\\")]
    lines = [
        line for line in TABLE.markdown().splitlines() if not re.match(r"\| :", line)
    ]
    assert len(rows) == len(lines) == 3
    assert all(row.count("&") - row.count(r"\&") == 2 for row in rows)
