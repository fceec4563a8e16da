"""Generate the whole recipe, verify it by replay, and write its digests.

    python scripts/make_recipe.py OUT --workers 16 [--digests FOLDER] [--only STEP]

Steps: generate, replay, digests; all three by default. Generated files are kept, so a
second run resumes the first one. Figures are printed as one JSON object.
Without --digests, the digests are written to OUT/digests; those of the package are in
src/lemma/dataset/digests.
"""

import argparse
import json
import platform
from pathlib import Path
from time import perf_counter
from typing import Any

from lemma.core.errors import DatasetError
from lemma.core.files import write_json, write_text
from lemma.core.workers.pool import ProcessPool
from lemma.dataset.files import (
    MANIFEST,
    content_digest,
    listed_files,
    listed_versions,
)
from lemma.dataset.recipe.files import load
from lemma.dataset.recipe.generate import GenerateConfig, generate
from lemma.dataset.recipe.replay import replay_all
from lemma.dataset.recipe.schema import executions, perturbed_as

VERSIONS = ("benchmark", "format", "mujoco", "revision")
"""Entries of the manifest that are written with the digests."""
STEPS = ("generate", "replay", "digests")


def export(folder: Path, out: Path) -> dict[str, Any]:
    """Write the digests of a recipe, beside those of other tasks.

    Args:
        folder: The recipe.
        out: Folder of the digests, ``src/lemma/dataset/digests``.

    Returns:
        The manifest of the digests.

    Raises:
        DatasetError: The recipe has perturbed executions.
    """
    versions = listed_versions(folder)
    if perturbed_as(versions):
        raise DatasetError(
            f"{folder} holds {executions(versions)}, which are no part of the "
            "benchmark. Export the digests of demonstrations."
        )
    lists: dict[str, dict[str, list[str]]] = {}
    for name, entry in listed_files(folder).items():
        split, _, task = name.removesuffix(".parquet").partition("/")
        lists.setdefault(split, {})[task] = entry["digests"]
    for split, tasks in lists.items():
        for task, digests in tasks.items():
            write_text(out / f"{task}-{split}.txt", "\n".join(digests) + "\n")
    splits = {}
    for split in sorted(lists):
        # The manifest counts the digests of other tasks, too.
        every = [
            digest
            for task in sorted(
                path.name.removesuffix(f"-{split}.txt")
                for path in out.glob(f"*-{split}.txt")
            )
            for digest in (out / f"{task}-{split}.txt").read_text("ascii").split()
        ]
        splits[split] = {"episodes": len(every), "sha256": content_digest(every)}
    manifest = {
        "versions": {name: versions[name] for name in VERSIONS},
        "splits": splits,
    }
    write_json(out / MANIFEST, manifest)
    return manifest


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    """Run the steps, and return the figures."""
    order = GenerateConfig(out=arguments.out, episodes=arguments.episodes)
    engine = ProcessPool(arguments.workers)
    steps = (arguments.only,) if arguments.only else STEPS
    figures: dict[str, Any] = {
        "machine": platform.processor() or platform.machine(),
        "libc": " ".join(platform.libc_ver()),
        "workers": arguments.workers,
    }
    if "generate" in steps:
        made = generate(order, engine)
        figures |= {
            "episodes": made.episodes,
            "made": made.made,
            "seconds": round(made.seconds, 1),
            "episodes_per_s": round(made.made / made.seconds, 2),
            "size_mb": round(made.size_mb, 1),
            "worker_mb": round(made.worker_mb),
        }
    if "replay" in steps:
        start = perf_counter()
        recipe = load(order.out)
        drifting = replay_all(recipe, engine)
        figures["replay_seconds"] = round(perf_counter() - start, 1)
        figures["drifting"] = [found.key for found in drifting]
    if "digests" in steps:
        folder = arguments.digests or order.out / "digests"
        figures["splits"] = export(order.out, folder)["splits"]
        files = folder.iterdir()
        figures["digests_kb"] = round(sum(f.stat().st_size for f in files) / 1e3)
    return figures


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--episodes", type=int, help="the first so many of every list")
    parser.add_argument("--digests", type=Path)
    parser.add_argument("--only", choices=STEPS)
    print(json.dumps(run(parser.parse_args()), indent=1))
