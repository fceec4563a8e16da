"""Directives that fill the pages with what the code says, so that they cannot drift.

``task-facts`` shows one instance of a task: who reaches what, the plan and the
instructions; with ``replays`` set (``make docs REPLAYS=1``) it plays it and adds a page
to turn it around. ``api`` documents the names in it, ``arms`` lists the arms and their
reach, ``attacks`` those of the audit, ``columns`` those of files of data, ``protocol``
all that the protocol fixes. ``constants`` makes a table of lines
``what | constant | unit | why``, ``engine-options`` one of ``name | why``.
``inserted-words`` lists what paraphrases have in common with the unseen templates.
"""

import logging
import math
import sys
from collections.abc import Iterator
from importlib import import_module
from inspect import isclass
from pathlib import Path
from typing import Any

import mujoco
from docutils import nodes
from docutils.statemachine import StringList
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from lemma.audit.attack import ATTACKS, TRIALS
from lemma.audit.run import names_at
from lemma.cli.tasks import describe
from lemma.core.workers.resumable import flat
from lemma.dataset.recipe import schema
from lemma.dataset.rendered import keyframes
from lemma.evaluation.protocol.rules import frozen
from lemma.expert.expert import Expert
from lemma.robots.collision_model import sweep_radius_m
from lemma.robots.could import could_of
from lemma.robots.reach import reach_of
from lemma.robots.ur.build import ARMS
from lemma.scene.build import compile_model
from lemma.scene.objects.entity import STICK, kind_of
from lemma.scene.scene import Scene
from lemma.tasks.drags import find_drag
from lemma.tasks.instance import Instance
from lemma.tasks.language.template import KINDS
from lemma.tasks.subtask import Primitive, SubTask
from lemma.tasks.suite import load_instance
from lemma.viewer.replays import write_recording
from lemma.viz.recording import FRAME_S, describe_subtask, record, robot_titles

sys.path.insert(0, str(Path(__file__).parents[1] / "scripts"))
from inserted_words import inserted_words, unseen_words
from make_pictures import MOMENTS

REPLAYS = "replays"
"""Folder of the documentation for episodes to turn around."""


class Generated(SphinxDirective):
    """A directive whose body is Markdown that code writes."""

    def run(self) -> list[nodes.Node]:
        """Return what the Markdown becomes."""
        container = nodes.container()
        lines = StringList(list(self.lines()), source=self.get_location())
        self.state.nested_parse(lines, self.content_offset, container)
        return container.children

    def lines(self) -> Iterator[str]:
        """Return the Markdown."""
        raise NotImplementedError


class TaskFacts(Generated):
    """``{task-facts} hook``: the instance whose picture the page shows."""

    required_arguments = 1

    def lines(self) -> Iterator[str]:
        """Return figures, reach, plan and instructions."""
        task = self.arguments[0]
        moment = MOMENTS[f"task_{task}"]
        facts = describe(task)
        yield (
            f"`{facts['gym_id']}`, {facts['subtasks']} sub-tasks, "
            f"{_span(facts['objects'])} objects, of which "
            f"{_span(facts['distractors'])} are distractors."
        )
        yield ""
        instance = load_instance(moment.task, "test", moment.index)
        titles = [*robot_titles(instance).values()]
        yield f"The picture shows `{instance.key}`. At its start:"
        yield ""
        yield "| | " + " | ".join(titles) + " |"
        yield "|---" * (len(titles) + 1) + "|"
        for name in instance.scene.object_names:
            extra = " (distractor)" if name in instance.distractors else ""
            cells = [_reach(instance, robot, name) for robot in range(len(titles))]
            yield f"| `{name}`{extra} | " + " | ".join(cells) + " |"
        yield ""
        goal = " and ".join(f"`On({a}, {b})`" for a, b in instance.goal.pairs)
        yield f"The goal is {goal}. The expert's plan:"
        yield ""
        for number, step in enumerate(_plan(instance), 1):
            yield f"{number}. {describe_subtask(step, instance)}"
        yield ""
        if self.config.replays:
            yield from self._replay(instance)
        yield "The instructions:"
        yield ""
        yield "| kind | instruction |"
        yield "|---|---|"
        for kind in KINDS:
            yield f"| `{kind}` | {instance.instructions[kind]} |"

    def _replay(self, instance: Instance) -> Iterator[str]:
        """Play the plan and write a page of its own; return where it is shown."""
        recording = record(instance, frame_s=FRAME_S)
        if not recording.success:
            raise self.error(f"The expert fails at {instance.key}.")
        task = instance.task
        path = f"{REPLAYS}/{task}.html"
        write_recording(Path(self.env.app.outdir) / path, recording)
        yield "```{raw} html"
        # Nothing is loaded before somebody looks.
        yield "<details ontoggle=\"this.lastElementChild.src ||= '" + path + "'\">"
        yield "<summary>See it move, and turn it around</summary>"
        yield f'<iframe title="{task}, to turn around"'
        yield ' style="width: 100%; height: 40rem; max-height: 90vh; border: 0">'
        yield "</iframe></details>"
        yield "```"
        yield ""
        yield f"It takes {recording.elapsed_s:.1f} simulated seconds."
        yield ""


def _plan(instance: Instance) -> Iterator[SubTask]:
    """Return the expert's sub-tasks, as it plans them at the start."""
    plan = Expert(Scene(instance.scene), instance.goal).plan()
    if plan is None:
        raise ValueError(f"The expert has no plan for {instance.key}.")
    for step in plan.steps:
        yield step.subtask


def _span(limits: list[int]) -> str:
    return f"{limits[0]} to {limits[1]}"


def _reach(instance: Instance, robot: int, name: str) -> str:
    """Return how a robot gets at an object: itself, with the stick, or not at all."""
    scene = instance.scene
    placed, pose = scene.robots[robot], scene.placement(name).pose
    if reach_of(placed.arm).margin(placed.base, pose.x, pose.y) > 0.0:
        return "reaches it"
    if STICK not in scene.object_names or not name.endswith("_cube"):
        return "–"
    bases = [(r.base.x, r.base.y, sweep_radius_m(r.arm)) for r in scene.robots]
    ways = []
    for primitive, receiver in ((Primitive.HOOK, robot), (Primitive.POKE, 1 - robot)):
        other = scene.robots[receiver]
        kind = kind_of(name)
        drag = find_drag(primitive, placed, other, pose, bases, kind, scene.gap_m)
        if drag is not None:
            ways.append(f"can {primitive} it")
    return " or ".join(ways) or "–"


class Constants(Generated):
    """A table of constants: ``what | constant | unit | why`` on each line."""

    has_content = True

    def lines(self) -> Iterator[str]:
        """Return the table."""
        yield "| what | value | constant | why |"
        yield "|---|---|---|---|"
        for line in self.content:
            what, path, unit, why = (part.strip() for part in line.split("|"))
            name = path.rpartition(".")[2]
            yield f"| {what} | {_value(path, unit)} | `{name}` | {why} |"


class Api(Generated):
    """Classes and functions by their docstrings: dotted names on its lines."""

    has_content = True

    def lines(self) -> Iterator[str]:
        """Return a directive of autodoc for each."""
        yield "```{eval-rst}"
        for name in " ".join(self.content).split():
            module, _, last = name.rpartition(".")
            found = getattr(import_module(module), last)
            yield f".. auto{'class' if isclass(found) else 'function'}:: {name}"
        yield "```"


class Columns(Generated):
    """``{columns maps}``: the columns of a recipe or of files of keyframes."""

    required_arguments = 1

    def lines(self) -> Iterator[str]:
        """Return the table."""
        name = self.arguments[0]
        if name in ("recipe", "perturbed"):
            yield from schema.describe(perturbed=name == "perturbed").splitlines()
        else:
            _, _, text = keyframes.describe().partition(f"### `{name}/`\n")
            yield from text.partition("###")[0].splitlines()


class Protocol(Generated):
    """A table of all that the protocol fixes; the hashes of lists are left out."""

    def lines(self) -> Iterator[str]:
        """Return the table."""
        yield "| what | value |"
        yield "|---|---|"
        for name, value in flat(frozen()):
            if not name.startswith("lists_sha256."):
                values = value if isinstance(value, list) else [value]
                yield f"| `{name}` | {', '.join(map(str, values))} |"


class Arms(Generated):
    """A table of every arm in the registry: where it works, what it could touch."""

    def lines(self) -> Iterator[str]:
        """Return the table."""
        yield (
            "| arm | nearest | carries up to | holds low up to | could touch up to "
            "| could put a cube up to | payload |"
        )
        yield "|---|---|---|---|---|---|---|"
        for name in ARMS:
            reach, could = reach_of(name), could_of(name)
            yield (
                f"| `{name}` | {reach.inner_m:.3f} m | {reach.travel_m:.3f} m "
                f"| {reach.grasp_m:.3f} m | {could.touch_m:.3f} m "
                f"| {could.place_m:.3f} m | {ARMS[name].payload_kg:g} kg |"
            )


class Attacks(Generated):
    """A table of every attack in the registry."""

    def lines(self) -> Iterator[str]:
        """Return the table."""
        header = "attack | level | attempts | candidates | simulated | cheap"
        yield f"| {header} | what it does |"
        yield "|---|---|---|---|---|---|---|"
        for level in TRIALS:
            for attack in map(ATTACKS.__getitem__, names_at(level)):
                cheap = "yes" if attack.cheap else ""
                yield (
                    f"| `{attack.name}` | {level} | {attack.attempts} "
                    f"| {attack.candidates} | {attack.simulated_s:g} s | {cheap} "
                    f"| {attack.summary} |"
                )


class InsertedWords(Generated):
    """The words of unseen templates that the training paraphrases insert."""

    def lines(self) -> Iterator[str]:
        """Return them, and of how many."""
        found = inserted_words()
        named = ", ".join(f"*{word}*" for word in found)
        yield f"{len(found)} of the {len(unseen_words())} such words: {named}."


class EngineOptions(Generated):
    """A table of MuJoCo's options: ``name | why`` on each line."""

    has_content = True

    def lines(self) -> Iterator[str]:
        """Return the table, read off a compiled scene."""
        options = compile_model(load_instance("stack", "test", 0).scene).opt
        yield "| option | value | why |"
        yield "|---|---|---|"
        for line in self.content:
            name, why = (part.strip() for part in line.split("|"))
            value = getattr(options, name)
            if name in _NAMED_OPTIONS:
                value = _NAMED_OPTIONS[name](value).name.split("_", 1)[1].capitalize()
            else:
                value = f"{value:g}"
            yield f"| `{name}` | {value} | {why} |"


_NAMED_OPTIONS = {
    "integrator": mujoco.mjtIntegrator,
    "cone": mujoco.mjtCone,
    "solver": mujoco.mjtSolver,
}


def _value(path: str, unit: str) -> str:
    """Return the value of a constant, ``package.module.NAME``, in a unit."""
    module, _, name = path.rpartition(".")
    value: Any = getattr(import_module(module), name)
    values = value if isinstance(value, tuple) else (value,)
    factor = {"mm": 1e3, "ms": 1e3, "°": math.degrees(1.0)}.get(unit, 1.0)
    text = ", ".join(f"{factor * number:g}" for number in values)
    return f"{text} {unit}".strip().replace(" °", "°")


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directives."""
    # viser's server would log every connection.
    logging.getLogger("websockets").setLevel(logging.WARNING)
    app.add_config_value("replays", False, "env", types=(bool, int, str))
    app.add_directive("task-facts", TaskFacts)
    app.add_directive("api", Api)
    app.add_directive("arms", Arms)
    app.add_directive("attacks", Attacks)
    app.add_directive("columns", Columns)
    app.add_directive("constants", Constants)
    app.add_directive("protocol", Protocol)
    app.add_directive("engine-options", EngineOptions)
    app.add_directive("inserted-words", InsertedWords)
    return {"parallel_read_safe": True}
