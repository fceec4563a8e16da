"""Verbs refuse in one line, before anything is written."""

from pathlib import Path

import pytest
from command import run
from recipes import small_recipe

LARGE = str(10**25)
RENDER = "render RECIPE --out OUT"
TRAIN = "train cliport --data nowhere --out OUT"
LEROBOT = f"{RENDER} --form lerobot"
REFUSED = (
    ("demo stak", "Did you mean 'stack'?"),
    ("show stak", "Valid: pass, pass2"),
    ("bench stak", "Unknown task 'stak'"),
    ("show stack --index 60", "0 to 59"),
    ("show stack --index -1", "from 0 to 59"),
    (f"demo stack --seed {LARGE}", f"from 0 to {2**63 - 1}"),
    (f"show pass --split free --index {LARGE}", "from 0 to 92"),
    ("show stack --split tset", "Did you mean 'test'?"),
    ("demo unison", "cannot do it in turns. Let them act together"),
    ("evaluate --policy oracle --tasks pass,unison --out OUT", "'unison' wants two th"),
    ("generate --tasks unison --perturb 0.5 --out OUT", "'unison' wants two things"),
    ("demo stack --robots ur5,ur1", "Valid: ur5, ur10"),
    ("demo stack --robots ur5", "a team has 2"),
    ("demo stack --seed -3", "from 0 to 92"),
    ("demo stack --seed 3 --index 3", "either"),
    ("bench stack --episodes 0", "from 1 to 60"),
    ("bench stack --workers 0", "--workers from 1"),
    ("bench --policy oracle --expert", "Name one of them"),
    ("inspect RECIPE --index 1", "Name it with --task"),
    ("inspect RECIPE --task stack --index 7", "no episode stack/test/7"),
    ("inspect RECIPE --task hook", "no episodes of task hook"),
    ("inspect RECIPE --split train", "and split train"),
    ("inspect nowhere", "lemma generate"),
    ("instructions stak", "Did you mean 'stack'?"),
    ("instructions stack --n 0", "at least 1"),
    ("instructions stack --seed -1", "at least 0"),
    ("reproduce papr", "Did you mean 'paper'?"),
    ("report nowhere", "There is no nowhere"),
    ("report", "Name a result"),
    ("compare nowhere nowhere", "no episodes in nowhere"),
    ("pull", "lemma pull"),
    ("pull org/data", "lemma pull"),
    ("pull org/data --weights small", "lemma pull"),
    (f"{RENDER} --size 640", "640x480"),
    (f"{RENDER} --tasks stak", "Did you mean 'stack'?"),
    (f"{RENDER} --workers 0", "1 or more"),
    (f"{RENDER} --form keyframes --no-depth", "--no-depth is for --form lerobot"),
    (f"{RENDER} --fps 20", "keyframes have no rate"),
    (f"{RENDER} --renderer warp", "rendered with OpenGL"),
    (f"{LEROBOT} --fps 30", "Choose one of 1, 2, 4, 5, 10"),
    (f"{LEROBOT} --renderer vulkan", "opengl"),
    (f"{LEROBOT} --instructions poem", "Unknown kind of instr"),
    (f"{LEROBOT} --size 63x48", "must be even"),
    (f"{LEROBOT} --size large", "is not a size"),
    (f"{LEROBOT} --engine ray --workers 2", "Leave out one"),
    (f"{LEROBOT} --tasks sleep", "Unknown task"),
    (f"{TRAIN} --samples 0", "samples cannot be 0; expected int >= 1"),
    (f"{TRAIN} --augmentation.dropouts -1", "augmentation.dropouts cannot be -1; "),
    (f"{TRAIN} --augmentation.brightness 1", "augmentation.brightness cannot be 1.0; "),
    ("audit --split free", "split free needs --episodes"),
    ("audit --episodes 61", "--episodes 61 do not fit the split test, which has inst"),
    ("audit --start 60", "--start 60 and --episodes all do not fit"),
    ("audit --start -1 --split free --episodes 2", "which has instances from 0 on"),
    ("audit --attacks drag_hom", "drag_home"),
    ("audit --attacks drag_home --level control", "at skill level"),
    ("audit --tasks ,", "contains no name"),
)


@pytest.mark.parametrize(("words", "message"), REFUSED)
def test_what_cannot_be_is_refused_in_one_line(
    words: str, message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    places = {"RECIPE": small_recipe() if "RECIPE" in words else "", "OUT": out}
    capsys.readouterr()  # The first recipe on a machine reports that kernels compile.
    assert run(*(places.get(word, word) for word in words.split())) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert message in told.err
    assert "Traceback" not in told.err
    assert told.err.count("\n") == 1
    assert not out.exists()
