"""The Parquet files of a recipe, and the versions that they depend on."""

import json
import os
from importlib.metadata import version
from pathlib import Path
from subprocess import DEVNULL, SubprocessError, check_output

import pyarrow as pa
import pyarrow.parquet as pq

from lemma.core.errors import DatasetError
from lemma.core.files import damaged, parse_json, write_whole
from lemma.core.version import VERSION
from lemma.dataset.recipe.schema import (
    FORMAT_VERSION,
    PERTURBED_SCHEMA,
    SCHEMA,
)

METADATA_KEY = b"lemma"
REVISION_VARIABLE = "LEMMA_REVISION"
"""Environment variable that says the git revision where the checkout has no .git."""
ROW_GROUP = 20
"""Episodes that are read together."""
WRITTEN_BY = "lemma generate"
"""The command that writes them."""


def versions(benchmark: str) -> dict[str, str]:
    """Return the versions that the bits of a recipe depend on.

    Args:
        benchmark: Version of the benchmark's instances.
    """
    return {
        "format": FORMAT_VERSION,
        "benchmark": benchmark,
        "lemma": VERSION,
        "mujoco": version("mujoco"),
        "numpy": version("numpy"),
        "numba": version("numba"),
        "revision": _revision(),
    }


def _revision() -> str:
    """Return the git revision of the package's checkout.

    Returns:
        ``"release"`` if the package is installed, and ``"unknown"`` if it runs from
        sources whose revision git does not say. Another project's repository, around
        an environment in which this package is installed, is not asked.
    """
    named = os.environ.get(REVISION_VARIABLE)
    if named:
        return named
    root = Path(__file__).parents[4]
    if not (root / "src/lemma").is_dir():
        return "release"
    if not (root / ".git").exists():
        return "unknown"
    try:
        return check_output(
            ["git", "describe", "--always", "--dirty", "--abbrev=40", "--match="],
            cwd=root,
            stderr=DEVNULL,
            text=True,
        ).strip()
    except (OSError, SubprocessError):
        return "unknown"


def write_table(path: Path, table: pa.Table, about: dict[str, str]) -> None:
    """Write a table of a recipe to Parquet, with a record of versions and settings."""
    metadata = {METADATA_KEY: json.dumps(about, sort_keys=True).encode()}
    # In one piece: the borders of pieces would change the bytes.
    table = table.replace_schema_metadata(metadata).combine_chunks()

    def write(draft: Path) -> None:
        pq.write_table(
            table,
            draft,
            compression="zstd",
            row_group_size=ROW_GROUP,
            write_page_checksum=True,
        )

    write_whole(path, write)


def open_table(path: Path) -> tuple[pq.ParquetFile, dict[str, str]]:
    """Open a Parquet file of a recipe.

    Returns:
        The file, and its record of versions and settings.

    Raises:
        DatasetError: It is truncated, or not of this format.
    """
    try:
        file = pq.ParquetFile(path, page_checksum_verification=True)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error, WRITTEN_BY)) from error
    found = (file.schema_arrow.metadata or {}).get(METADATA_KEY)
    known = (SCHEMA.names, PERTURBED_SCHEMA.names)
    if found is None or file.schema_arrow.names not in known:
        raise DatasetError(
            f"{path} is no recipe of this benchmark. Recipes are written by "
            "'lemma generate'."
        )
    about: dict[str, str] = parse_json(found, path)
    if about.get("format") != FORMAT_VERSION:
        raise DatasetError(
            f"{path} has format {about.get('format')}, and this version of the package "
            f"reads format {FORMAT_VERSION}. Install the version that wrote it "
            f"({about.get('lemma')}), or generate it again."
        )
    return file, about


def read_table(path: Path, columns: list[str] | None = None) -> pa.Table:
    """Read a Parquet file of a recipe.

    Args:
        path: The file.
        columns: Names of columns; all if None.

    Raises:
        DatasetError: It is damaged, or not of this format.
    """
    file, _ = open_table(path)
    try:
        return file.read(columns=columns)
    except (OSError, pa.ArrowException) as error:
        raise DatasetError(damaged(path, error, WRITTEN_BY)) from error
