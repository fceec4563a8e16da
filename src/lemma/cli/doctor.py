"""`lemma doctor`: checks of the installation."""

from dataclasses import asdict

from rich.table import Table
from rich.text import Text

from lemma.bench.checks import Check, run_checks
from lemma.bench.machine import describe_machine
from lemma.cli.options import Flag, JsonFlag, messages, output, print_json


def doctor(
    states: Flag = False, evaluation: Flag = False, as_json: JsonFlag = False
) -> int:
    """Check versions, rendering, physics and the expert; list what is missing.

    Args:
        states: Compare the simulated states of every control mode in every task with
            those of other machines, which takes a minute; a few are always compared.
        evaluation: Play a fixed sample of each level, and compare it with the published
            lines.
        as_json: Print one JSON object instead of a table.
    """
    with messages().status("Checking (the first run compiles, for half a minute) ..."):
        checks = run_checks(all_states=states)
        if evaluation:
            from lemma.bench.evaluation_checks import check_evaluation

            checks += check_evaluation()
        machine = describe_machine()
    healthy = all(check.ok for check in checks if check.essential)
    if as_json:
        print_json(
            {
                "ok": healthy,
                "machine": machine,
                "checks": [asdict(check) for check in checks],
            }
        )
    else:
        _print(checks, machine, healthy)
    return 0 if healthy else 1


def _print(checks: list[Check], machine: dict[str, object], healthy: bool) -> None:
    console = output()
    console.print(
        f"{machine['system']}, {machine['processor']}, {machine['cores']} cores, "
        f"{machine['memory_gb']} GB"
    )
    table = Table.grid(padding=(0, 2, 0, 0))
    for check in checks:
        if check.ok:
            mark = Text("ok", style="green")
        elif check.essential:
            mark = Text("FAILED", style="bold red")
        else:
            mark = Text("note", style="yellow")
        # Text, because paths and messages may contain markup characters.
        found = Text(check.found)
        if not check.ok:
            found.append(f"\n{check.advice}", style="bold")
        table.add_row(mark, check.name, found)
    console.print(table)
    if healthy:
        console.print("All required parts work.", style="green")
    else:
        console.print("A required part does not work.", style="bold red")
