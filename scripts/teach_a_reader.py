"""Teach the reader of a team's ReachNet sentences alone, without pictures.

python scripts/teach_a_reader.py RUN OUT [STEPS] [SEED]
python scripts/teach_a_reader.py RUN

RUN is a folder that ``lemma train team-reachnet`` wrote, or the name of weights; OUT
gets the same network with a reader that has read more. Its lessons are sentences about
the tables of the training lists, half of them relational, with the true scene in place
of what the network sees. No other weight changes. Takes a second a step on one core.

Without OUT it teaches nothing, and prints which share of the sentences of the test
lists is read rightly, with true scenes.
"""

import math
import sys
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from lemma.core.seeding import stream
from lemma.policies.batch import NOBODY, STOP, Batch, Labels
from lemma.policies.entities import EntitySet
from lemma.policies.models.team_reachnet.model import TeamReachNet
from lemma.policies.models.team_reachnet.reader import Reading, Wanted
from lemma.policies.models.team_reachnet.table import TeamTable, true_table
from lemma.policies.models.team_reachnet.teams import ROBOTS, colored
from lemma.policies.text.encoder import Sentences
from lemma.policies.text.instructions import with_instructions, with_places
from lemma.policies.weights import find_weights, load_model
from lemma.policies.weights_file import read_metadata, write_weights
from lemma.scene.raster import RASTER
from lemma.tasks.instance import Instance
from lemma.tasks.language.relational import relational
from lemma.tasks.suite import load_instance

TASKS = (
    *("relay", "line", "carousel", "sort", "tower", "exchange", "strong", "unison"),
    *("pass", "stack", "pass2", "stack2"),
)
TABLES = 140
"""Number of tables of each task, as many as the network has seen."""
TEST_TABLES = 60
KINDS = ("high_level", "human", "unseen", "relational")
BATCH, RATE, WARM_UP, RELATIONAL, PARAPHRASES = 128, 5e-4, 50, 0.5, 0.7


def batch_of(instances: Sequence[Instance], entities: EntitySet) -> Batch:
    """Return the tables of instances as a labelled batch with empty maps."""
    count = len(instances)
    objects = torch.full((count, len(entities), 7), math.nan)
    bases = torch.zeros(count, ROBOTS, 3)
    for row, instance in enumerate(instances):
        for placed in instance.scene.objects:
            pose = (*placed.pose.xy, 0.0, 1.0, 0.0, 0.0, 0.0)
            objects[row, entities.number(placed.name)] = torch.tensor(pose)
        for i, robot in enumerate(instance.scene.robots):
            bases[row, i] = torch.tensor([*robot.base.xy, robot.base.yaw])
    rules = [instance.goal.rule for instance in instances]
    nothing = torch.full((count, 4), -1)
    labels = Labels(
        episode=torch.arange(count),
        keyframe=torch.zeros(count, dtype=torch.int64),
        # A "stop"; the reader does not learn decisions.
        decision=torch.tensor([[NOBODY, STOP, NOBODY, NOBODY]]).expand(count, -1),
        pick_pose=torch.zeros(count, 3),
        place_pose=torch.zeros(count, 3),
        objects=objects,
        bases=bases,
        gap_m=torch.zeros(count, 2),
        arms=torch.zeros(count, ROBOTS, dtype=torch.int64),
        tasks=[instance.task for instance in instances],
        goals=[instance.goal.pairs for instance in instances],
        robot_colors=[tuple(r.color for r in i.scene.robots) for i in instances],
        rules=[() if rule is None else (rule.kind, *rule.names) for rule in rules],
        hands=[()] * count,
        heavy=torch.zeros(count, len(entities), dtype=torch.bool),
        perturbed=torch.zeros(count, dtype=torch.bool),
    )
    maps = torch.zeros(count, 1, 1)
    return Batch(
        rgb=maps[..., None].expand(-1, -1, -1, 3).to(torch.uint8),
        height_m=maps,
        coverage=maps.bool(),
        joints=torch.zeros(count, ROBOTS, 6),
        opening_m=torch.zeros(count, ROBOTS),
        past=nothing[:, None],
        instructions=[""] * count,
        sub_instructions=[""] * count,
        raster=RASTER,
        entities=entities,
        labels=labels,
    )


def drawn(batch: Batch, step: int, seed: int) -> Batch:
    """Return some rows with new sentences."""
    rng = stream("lesson", seed, step)
    rows = rng.choice(len(batch), BATCH, replace=False).tolist()
    labels = batch.labels
    assert labels is not None
    part = replace(
        batch, **_rows(batch, rows), labels=replace(labels, **_rows(labels, rows))
    )
    part = with_instructions(part, seed, step, paraphrases=PARAPHRASES)
    return with_places(part, RELATIONAL, rng)


def _rows(record: Batch | Labels, rows: list[int]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for one in fields(record):
        value = getattr(record, one.name)
        if isinstance(value, Tensor):
            found[one.name] = value[rows]
        elif isinstance(value, list):
            found[one.name] = [value[row] for row in rows]
    return found


def read(network: TeamReachNet, batch: Batch) -> tuple[Reading, Wanted]:
    """Return the readings of a batch in its true scenes, and what is right."""
    tensors = network.text_tensors(batch)
    batch, labels = colored(batch, tensors["robot"])
    assert labels is not None
    table: TeamTable = true_table(
        labels, torch.ones(len(batch), ROBOTS, 3), tensors["robot"] >= 0,
        tensors["weak"], batch.entities,
    )  # fmt: skip
    wanted = Wanted(*(tensors[f"wanted_{name}"] for name in Wanted._fields))
    words = Sentences(*tensors["words"])
    return network.reader.understand(words, table, tensors["color"]), wanted


@torch.no_grad()
def measure(network: TeamReachNet) -> None:
    """Print the share of the test sentences whose goal is read rightly, by kind."""
    instances = [
        load_instance(task, "test", k) for task in TASKS for k in range(TEST_TABLES)
    ]
    batch = batch_of(instances, EntitySet.of(network.config.entities))
    for kind in KINDS:
        texts = [one.instructions.get(kind) or relational(one) for one in instances]
        found, wanted = read(network.eval(), replace(batch, instructions=texts))
        bottoms = found.decided().bottoms
        targets = bottoms.shape[-1] - 1
        goals = (bottoms == wanted.shares(targets).bottoms).all(-1).all(-1)
        rules = found.rule.argmax(-1) == wanted.rule
        print(f"{kind}: goals {goals.double().mean():.1%}, rules", end=" ")
        print(f"{rules.double().mean():.1%}")


def main(run: str, out: str, steps: int = 600, seed: int = 0) -> None:
    """Teach, and write the network."""
    torch.manual_seed(seed)
    source, made = find_weights(run), Path(out, "weights.safetensors")
    network = load_model(run)
    assert isinstance(network, TeamReachNet)
    entities = EntitySet.of(network.config.entities)
    batch = batch_of(
        [load_instance(task, "train", k) for task in TASKS for k in range(TABLES)],
        entities,
    )
    reader = network.reader.train()
    optimizer = torch.optim.AdamW(
        reader.parameters(), RATE, betas=(0.9, 0.98), weight_decay=0.02
    )
    for step in range(steps):
        warm = min(1.0, (step + 1) / WARM_UP)
        share = 0.5 * (1.0 + math.cos(math.pi * step / steps))
        optimizer.param_groups[0]["lr"] = RATE * warm * share
        found, wanted = read(network, drawn(batch, step, seed))
        terms = reader.reading_loss(found, wanted)
        optimizer.zero_grad()
        torch.stack([*terms.values()]).sum().backward()
        torch.nn.utils.clip_grad_norm_(reader.parameters(), 1.0)
        optimizer.step()
        if step % 20 == 0 or step == steps - 1:
            numbers = (
                f"{name} {float(term.detach()):.3f}" for name, term in terms.items()
            )
            print(step, *numbers, flush=True)
    metadata = read_metadata(source)
    command = f"python scripts/teach_a_reader.py {run} {out} {steps} {seed}"
    Path(out).mkdir(parents=True, exist_ok=True)
    write_weights(
        made,
        network.eval().state_dict(),
        replace(metadata, command=f"{metadata.command}; {command}", packed={}),
    )


if __name__ == "__main__":
    run, *more = sys.argv[1:]
    if more:
        main(run, more[0], *map(int, more[1:]))
    else:
        taught = load_model(run)
        assert isinstance(taught, TeamReachNet)
        measure(taught)
