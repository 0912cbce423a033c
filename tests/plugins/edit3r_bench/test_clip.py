"""CLIP similarity and the clip loss on a tiny random CLIP, loaded the way users load theirs."""

import json
from importlib.util import find_spec

import pytest
import torch
from edit3r_bench.features import ClipSimilarity, central_square, directional_similarity

from edit3r.contract.errors import MissingDependencyError
from edit3r_testing import CONTRACTS, Contract, claims, contract_for

if find_spec("transformers") is None:
    pytest.skip("needs transformers", allow_module_level=True)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Vocabulary: the 256 bytes, alone and at word end."""
    import transformers
    from transformers.convert_slow_tokenizer import bytes_to_unicode

    folder = tmp_path_factory.mktemp("clip")
    letters = list(bytes_to_unicode().values())
    words = [*letters, *(letter + "</w>" for letter in letters)]
    words += ["<|startoftext|>", "<|endoftext|>"]
    numbered = {word: index for index, word in enumerate(words)}
    (folder / "vocab.json").write_text(json.dumps(numbered))
    (folder / "merges.txt").write_text("#version: 0.2\n")
    read = transformers.CLIPTokenizerFast.from_pretrained
    read(folder, model_max_length=77).save_pretrained(folder)
    small = {"projection_dim": 16, "hidden_size": 32, "intermediate_size": 37}
    small |= {"num_hidden_layers": 2, "num_attention_heads": 4}
    tokens = {"vocab_size": 514, "bos_token_id": 512}
    tokens |= {"eos_token_id": 513, "pad_token_id": 513}
    config = transformers.CLIPConfig(
        text_config={**small, **tokens},
        vision_config={**small, "image_size": 32, "patch_size": 8},
        projection_dim=16,
    )
    torch.manual_seed(0)
    transformers.CLIPModel(config).save_pretrained(folder)
    return folder


@pytest.fixture(scope="module")
def similarity(folder):
    return ClipSimilarity(str(folder), local_files_only=True)


@pytest.fixture
def images():
    return torch.rand(2, 3, 40, 56, generator=torch.Generator().manual_seed(0))


def test_similarity_is_a_cosine_for_every_picture_and_text(similarity, images):
    cosines = similarity(images, ["a red bike", "snow", "a red bike"])
    assert cosines.shape == (2, 3) and cosines.abs().max() <= 1
    assert torch.allclose(cosines[:, 0], cosines[:, 2], atol=1e-6)
    assert not torch.allclose(cosines[:, 0], cosines[:, 1], atol=1e-4)


def test_it_agrees_with_transformers_own_forward(similarity, images):
    texts = ["a red bike", "snow"]
    tokens = similarity.tokenizer(texts, padding=True, return_tensors="pt")
    with torch.no_grad():
        output = similarity.model(pixel_values=central_square(images, 32), **tokens)
        cosines = output.logits_per_image / similarity.model.logit_scale.exp()
    assert torch.allclose(similarity(images, texts), cosines, atol=1e-5)


def test_the_central_square_is_cut_without_stretching():
    images = torch.zeros(1, 3, 32, 64)
    images[..., 16:48] = 1
    square = central_square(images, 32)
    assert square.shape == (1, 3, 32, 32)
    assert torch.allclose(square, square[..., :1, :1].expand_as(square))


def test_colours_are_normalised_as_clip_was_trained():
    """As published with CLIP: openai/CLIP, clip/clip.py."""
    mean = torch.tensor([0.48145466, 0.4578275, 0.40821073])
    deviation = torch.tensor([0.26862954, 0.26130258, 0.27577711])
    for colour in (0.0, 1.0):
        given = central_square(torch.full((1, 3, 40, 56), colour), 32)
        expected = (colour - mean) / deviation
        assert torch.allclose(given.mean((0, 2, 3)), expected, atol=1e-5)


def test_a_very_long_text_is_cut(similarity, images):
    assert similarity(images, ["bike " * 100]).shape == (2, 1)


def test_missing_weights_are_a_sentence():
    with pytest.raises(MissingDependencyError, match="hf download openai/clip"):
        ClipSimilarity(local_files_only=True)


@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["loss"])} - {*claims(Contract)})
)
def test_the_clip_loss_keeps_the_contract(folder, claim):
    getattr(contract_for("loss", "clip", model=str(folder))(), claim)()


class TwoAxes:
    """In the place of CLIP: pictures are told apart by red and blue, texts by their first
    letter.
    """

    def embed_images(self, images):
        return torch.nn.functional.normalize(images[:, [0, 2]].mean((2, 3)), dim=-1)

    def embed_texts(self, texts):
        return torch.eye(2)[[0 if text.startswith("r") else 1 for text in texts]]


def test_direction_is_one_for_the_wished_change_and_zero_for_none():
    red, blue = torch.zeros(1, 3, 4, 4), torch.zeros(1, 3, 4, 4)
    red[:, 0], blue[:, 2] = 1, 1
    wished = ("red", "blue")
    assert directional_similarity(TwoAxes(), red, blue, *wished) == pytest.approx(1)
    assert directional_similarity(TwoAxes(), blue, red, *wished) == pytest.approx(-1)
    assert directional_similarity(TwoAxes(), red, red, *wished) == 0


def test_direction_runs_on_a_real_network(similarity, images):
    texts = ("a house", "a red house")
    value = directional_similarity(similarity, images, 1 - images, *texts)
    assert value.shape == (2,) and value.abs().max() <= 1
