"""`lemma serve`: a policy behind a socket; or the self-test of somebody's server."""

from typing import Annotated, Literal

import tyro

from lemma.cli.options import Flag, JsonFlag, Word, output, print_json
from lemma.core.errors import InvalidConfigError
from lemma.evaluation.run.loading import weights_of
from lemma.evaluation.run.server_check import check_server
from lemma.policies.spec import ORACLE, PolicySpec
from lemma.serve.selftest.known_inputs import CHECKS, SelfTestReport
from lemma.serve.server.server import DEFAULT_PORT
from lemma.serve.server.server import serve as run

_HOST = "127.0.0.1"
_WHO = {
    "helper": "The server of lemma-bench answered for its own decoding. A policy with "
    "a method describe() answers for itself; see docs/serving.md.",
    "nobody": "The server does not know the message 'check'; see docs/serving.md.",
}


def serve(
    policy: Word = None,
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = _HOST,
    port: Annotated[int, tyro.conf.arg(metavar="PORT")] = DEFAULT_PORT,
    planning: Literal["single-step", "multi-step"] = "single-step",
    check: Annotated[
        str | None, tyro.conf.arg(metavar="URL", help_behavior_hint="")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Answer for a policy over a socket, until Ctrl-C; or test a server with --check.

    Args:
        policy: A model; PLANNER+GROUNDER; or package.module:Class.
        host: Address to listen at. There is no password: keep it at this machine.
        port: Port to listen at; 0 for any that is free.
        planning: Look before every sub-task, or plan from the first image alone.
        check: Ask this server what it understands, and name its mistakes.
        as_json: With --check, print one JSON object.

    Returns:
        Exit code: 1 if the test found a mistake.
    """
    if (policy is None) == (check is None):
        raise InvalidConfigError(
            "Give either --policy, to serve it, or --check with the address of a "
            "server, to test it."
        )
    if check is not None:
        return _report(check_server(check), as_json=as_json)
    spec = PolicySpec(str(policy), planning)
    if ORACLE in spec.parts:
        raise InvalidConfigError(
            "The oracle cannot be served: it needs the truth, which never travels. "
            "Serve the other part, and evaluate --policy http://HOST:PORT+oracle."
        )
    about = {
        "name": spec.name,
        "planning": spec.planning,
        "weights": weights_of(spec),
    }
    run(spec.load(), host=host, port=port, about=about, on_ready=_announce)
    # It returns at Ctrl-C alone.
    raise KeyboardInterrupt("Interrupted: nobody is answered any more.")


def _announce(url: str) -> None:
    output().print(f"Ready: lemma evaluate --policy {url} --out DIR", soft_wrap=True)


def _report(report: SelfTestReport, as_json: Flag) -> int:
    if as_json:
        print_json(
            {
                "ok": report.ok,
                "by": report.by,
                "acts": report.acts,
                "checks": {name: report.mistakes.get(name) for name in CHECKS},
            }
        )
        return 0 if report.ok else 1
    console = output()
    for name in CHECKS if report.by != "nobody" else ():
        mistake = report.mistakes.get(name)
        verdict = "[green]right[/]" if mistake is None else "[bold red]WRONG[/]"
        console.print(f"{name:<18} {verdict}")
        if mistake is not None:
            console.print(f"    {mistake}", markup=False, soft_wrap=True)
    if report.acts:
        console.print(report.acts, markup=False, soft_wrap=True)
    if report.by in _WHO:
        console.print(_WHO[report.by], markup=False, soft_wrap=True)
    return 0 if report.ok else 1
