"""A very small SmolVLA is trained as documented, and played.

Its weights are random: nothing is downloaded, and nothing is learned.
"""

import math
import re
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from check_text_policies import ACTION, BASES, IMAGES, STATE, dataset, training
from check_training import run, work
from lerobot.configs import FeatureType, PolicyFeature, PreTrainedConfig
from lerobot.policies import get_policy_class, make_pre_post_processors

import lemma
from lemma.evaluation.run.rollout import Rollout
from lemma.policies.control.interfaces import ControlInput
from lemma.policies.control.lerobot import LeRobotPolicy

NAME, STEPS, EXECUTED = "smolvla", 2, 10
SPECIAL = {
    "fake_image_token": "<fake_token_around_image>",
    "image_token": "<image>",
    "global_image_token": "<global-img>",
    "end_of_utterance_token": "<end_of_utterance>",
}
ENDS = {"unk_token": "<unk>", "pad_token": "<pad>"}
SIDE_PX, PATCH_PX, SCALE = 64, 16, 2


@cache
def language_model() -> str:
    """Write configuration, tokenizer and processor of a small SmolVLM."""
    transformers, tokenizers = map(import_module, ("transformers", "tokenizers"))
    said = sorted(set(re.findall(r"\w+|[^\w\s]", " ".join(dataset().meta.tasks.index))))
    words = [*ENDS.values(), *SPECIAL.values(), *said]
    numbers = {word: number for number, word in enumerate(words)}
    tokens = tokenizers.Tokenizer(
        tokenizers.models.WordLevel(numbers, unk_token=ENDS["unk_token"])
    )
    tokens.pre_tokenizer = tokenizers.pre_tokenizers.Whitespace()
    tokenizer = transformers.PreTrainedTokenizerFast(
        tokenizer_object=tokens, extra_special_tokens=SPECIAL, **ENDS
    )
    pad, image = numbers[ENDS["pad_token"]], numbers[SPECIAL["image_token"]]
    plain = {"num_attention_heads": 4, "intermediate_size": 64}
    vision = {"hidden_size": 32, "num_hidden_layers": 1, "patch_size": PATCH_PX}
    text = {"hidden_size": 64, "num_hidden_layers": 2, "num_key_value_heads": 2}
    more = {"head_dim": 16, "vocab_size": len(words), "pad_token_id": pad}
    config = transformers.SmolVLMConfig(
        vision_config={**plain, **vision, "image_size": SIDE_PX},
        text_config={**plain, **text, **more, "model_type": "llama"},
        scale_factor=SCALE,
        image_token_id=image,
        pad_token_id=pad,
    )
    processor = transformers.SmolVLMProcessor(
        transformers.SmolVLMImageProcessor(),
        tokenizer,
        transformers.SmolVLMVideoProcessor(),
        image_seq_len=(SIDE_PX // PATCH_PX // SCALE) ** 2,
    )
    folder = work() / "small-smolvlm"
    for part in (config, processor):
        part.save_pretrained(folder)
    return str(folder)


@cache
def small_base() -> Path:
    """Return what stands in for the published weights: other cameras and a state."""
    image = PolicyFeature(FeatureType.VISUAL, (3, 256, 256))
    config = PreTrainedConfig.get_choice_class(NAME)(
        input_features={
            STATE: PolicyFeature(FeatureType.STATE, (6,)),
            **{f"{IMAGES}camera{number}": image for number in (1, 2, 3)},
        },
        output_features={ACTION: PolicyFeature(FeatureType.ACTION, (6,))},
        device="cpu",
        push_to_hub=False,
        vlm_model_name=language_model(),
        num_vlm_layers=2,
        resize_imgs_with_padding=(SIDE_PX, SIDE_PX),
        num_steps=2,
    )
    folder = work() / "small-smolvla"
    for part in (get_policy_class(NAME)(config), *make_pre_post_processors(config)):
        part.save_pretrained(folder)
    return folder


@cache
def checkpoint() -> str:
    """Train with the documented options, for two steps."""
    path = f"--policy.path={BASES[NAME]}"
    words = [word for word in training(NAME) if word != path]
    told = run(
        "lerobot-train",
        *words,
        f"--policy.path={small_base()}",
        f"--dataset.root={dataset().root}",
        "--dataset.video_backend=pyav",
        "--batch_size=2",
        f"--steps={STEPS}",
        "--num_workers=0",
        "--log_freq=1",
        "--output_dir=read-and-trained",
    )
    losses = [float(loss) for loss in re.findall(r"\sloss:(\S+)", told)]
    assert len(losses) == STEPS
    assert all(map(math.isfinite, losses))
    return str(work() / "read-and-trained/checkpoints/last/pretrained_model")


def test_it_is_trained_as_documented_and_evaluated(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Rollout, "horizon_s", 2.0)
    found = lemma.evaluate(
        f"lerobot:{checkpoint()}", tasks="stack", split="val", episodes=1
    )
    assert not found.errors
    (row,) = found.rows
    assert (row["control"]["actions"], row["control"]["asked"]) == (20, 20 / EXECUTED)


def answers(*said: tuple[str, int]) -> list[Any]:
    """Return the chunks of one batch: of one view, with these texts at these steps."""
    policy = LeRobotPolicy(checkpoint())
    env = lemma.make("pass", split="val", **policy.control_options)
    observation, _ = env.reset(seed=0)
    given = [
        ControlInput(
            instruction=text, robots=("a", "b"), observation=observation, step=step
        )
        for text, step in said
    ]
    return [np.asarray(chunk.rows) for chunk in policy.act(given)]


def test_it_reads_the_instruction_and_not_its_place_in_the_batch() -> None:
    one, other = list(dataset().meta.tasks.index)
    first, second, third, later = answers((one, 0), (other, 0), (one, 0), (one, 9))
    assert first.shape == (EXECUTED, 2, 7)
    assert np.array_equal(first, third)
    assert np.array_equal(second, *answers((other, 0)))
    assert not np.allclose(first, second, atol=1e-4)
    # Each step has other noise.
    assert not np.allclose(first, later, atol=1e-4)
