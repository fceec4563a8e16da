"""`lemma serve`: a server for a policy, or a test of a server."""

from typing import Annotated, Literal

import tyro

from lemma.cli.options import (
    Arguments,
    Flag,
    JsonFlag,
    Word,
    arguments,
    output,
    print_json,
)
from lemma.core.errors import InvalidConfigError

_HOST = "127.0.0.1"
_PORT = 8000


def serve(
    policy: Word = None,
    host: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = _HOST,
    port: Annotated[int, tyro.conf.arg(metavar="PORT")] = _PORT,
    planning: Literal["single-step", "multi-step"] = "single-step",
    policy_args: Arguments = "",
    protocol: Literal["lemma", "vla-eval"] = "lemma",
    check: Annotated[
        str | None, tyro.conf.arg(metavar="URL", help_behavior_hint="")
    ] = None,
    as_json: JsonFlag = False,
) -> int:
    """Serve a policy over a socket until Ctrl-C; or test a server with --check.

    Args:
        policy: A model; PLANNER+GROUNDER; or package.module:Class.
        host: Address to listen on, by default only for this machine: no password.
        port: Port to listen on; 0 for any free one.
        planning: single-step: observe before every sub-task; multi-step: plan all
            sub-tasks from the first observation.
        policy_args: Arguments of a class; or, with --check, the environment of
            a model server.
        protocol: lemma; or vla-eval, only for motor commands.
        check: Address of a server; compare one decision of it with the known answer.
        as_json: With --check, print one JSON object.

    Returns:
        Exit code: 1 if the answer of the checked server is wrong.
    """
    # Import late, so that help is fast.
    from lemma.evaluation.run.loading import weights_of
    from lemma.policies.spec import ORACLE, PolicySpec
    from lemma.serve.server import serve as run

    if (policy is None) == (check is None):
        raise InvalidConfigError(
            "Use either --policy, to serve it, or --check with the address of a "
            "server, to test it."
        )
    if check is not None:
        return _check(check, policy_args, as_json)
    spec = PolicySpec(str(policy), planning, arguments=arguments(policy_args))
    if ORACLE in spec.parts:
        raise InvalidConfigError(
            "The oracle cannot be served: it needs the simulation's state, which no "
            "other process gets. Serve the other part, and evaluate --policy "
            "http://HOST:PORT+oracle."
        )
    scheme = "http" if protocol == "lemma" else protocol
    weights = weights_of(spec)
    run(
        spec.load(),
        host=host,
        port=port,
        about={"name": spec.name, "planning": spec.planning, "weights": weights},
        protocol=protocol,
        on_ready=lambda url: _announce(url.replace("http", scheme)),
    )
    # `run` returns only after Ctrl-C.
    raise KeyboardInterrupt("Interrupted: the server has stopped.")


def _announce(url: str) -> None:
    output().print(f"Ready: lemma evaluate --policy {url} --out DIR", soft_wrap=True)


def _check(url: str, policy_args: str, as_json: Flag) -> int:
    from lemma.evaluation.run.server_check import check_server

    found = check_server(url, arguments(policy_args))
    if as_json:
        document = {"ok": found.ok, "instruction": found.instruction, **found.answer}
        if "subtask" in document:
            document["subtask"] = document["subtask"].to_dict()
        print_json({**document, "mistakes": found.mistakes})
        return 0 if found.ok else 1
    console = output()
    lines = [
        f"asked: {found.instruction}",
        *(f"{name}: {value or 'none'}" for name, value in found.answer.items()),
        *(f"WRONG {name}: {text}" for name, text in found.mistakes.items()),
    ]
    console.print("\n".join(lines), markup=False, soft_wrap=True)
    if found.ok:
        console.print("All answers are correct.", style="green")
    return 0 if found.ok else 1
