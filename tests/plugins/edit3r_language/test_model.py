"""Readers by a language model, against a service of the test and a tiny network."""

import json
from types import SimpleNamespace

import pytest
import torch
from edit3r_language.model import ServiceReader, _as_text

import edit3r
from edit3r.contract.errors import (
    InputError,
    MissingDependencyError,
    RunError,
)
from edit3r.running import RunJob, make_run_config, preview
from edit3r_testing import CONTRACTS, Contract, claims, contract_for

SENTENCE = "male die Wand rot"
CHANGES = [{"kind": "paint", "colour": "red"}]
THING = {"scope": "named", "name": "wall"}
INSTRUCTION = {"action": "paint", "thing": THING, "changes": CHANGES, "text": SENTENCE}
RIGHT = json.dumps({"instructions": [INSTRUCTION]})
GIBBERISH = {"action": "other", "thing": {}, "text": "", "unread": ["qwxz", "vbnk"]}


def service(chat, **settings):
    return edit3r.build("reader", "model", base_url=chat.url, **settings)


# ---- behind an address ----


def test_a_service_reads_any_language_and_gets_the_sentence_alone(chat):
    chat.answers.append(RIGHT)
    assert list(map(str, service(chat).read(SENTENCE))) == ["wall: red"]
    (request,) = chat.requests
    system, user = request["messages"]
    assert "JSON" in system["content"]
    assert user == {"role": "user", "content": SENTENCE}
    assert request["temperature"] == 0


def test_an_answer_of_another_form_is_sent_back_with_what_is_wrong(chat):
    chat.answers.extend(["Done!", RIGHT])
    assert service(chat).read(SENTENCE)[0].target.name == "wall"
    *_, answer, complaint = chat.requests[1]["messages"]
    assert answer["content"] == "Done!"
    assert "no JSON object" in complaint["content"]


def test_of_an_endless_answer_only_the_beginning_is_sent_back(chat):
    chat.answers.extend(["x" * 1_000_000, RIGHT])
    service(chat).read(SENTENCE)
    assert len(chat.requests[1]["messages"][2]["content"]) == 10_000


def test_after_all_attempts_the_model_is_quoted_and_there_is_a_way_out(chat):
    chat.answers.append("I will not\x1b[2J")
    told = (
        r"no JSON object \(I will not \[2J\); say it otherwise, or leave --reader out"
    )
    with pytest.raises(RunError, match=told):
        service(chat, attempts=3).read(SENTENCE)
    assert len(chat.requests) == 3


@pytest.mark.parametrize("answer", [500, 401, ""])
def test_a_service_that_fails_is_named_without_the_key(chat, answer):
    chat.answers.append(answer)
    with pytest.raises(RunError, match=r"gpt-4\.1-mini") as failed:
        service(chat).read(SENTENCE)
    assert "very-secret" not in str(failed.value)


def test_without_a_key_or_a_server_of_ones_own_it_says_what_to_set(monkeypatch):
    pytest.importorskip("openai")
    monkeypatch.delenv("OPENAI_API_KEY", raising=False)
    with pytest.raises(MissingDependencyError, match=r"OPENAI_API_KEY.*base_url"):
        edit3r.build("reader", "model")


def test_a_thing_alone_is_read_as_what_is_removed(chat):
    instruction = {
        "action": "remove",
        "thing": {**THING, "which": ["left"]},
        "text": "x",
    }
    chat.answers.append(
        json.dumps({"instructions": [{**instruction, "text": "remove die linke Wand"}]})
    )
    thing = service(chat).read_target("die linke Wand")
    assert (thing.name, thing.qualifiers) == ("wall", ("left",))


@pytest.mark.slow
def test_a_run_reads_its_prompt_once_by_the_chosen_reader(chat, tmp_path):
    """And editors get its instructions: recolor, which knows no German, paints the wall."""
    chat.answers.append(RIGHT)
    left, right = torch.rand(2, 3, 32, 48, generator=torch.Generator().manual_seed(0))
    views = edit3r.Views(
        torch.stack((left, right))[None], torch.eye(3).expand(1, 2, 3, 3)
    )
    reader = {"name": "model", "base_url": chat.url}
    config = make_run_config({"prompt": SENTENCE, "reader": reader})
    preview(RunJob(config, views, masks=torch.ones(1, 2, 32, 48)))
    assert len(chat.requests) == 1


# ---- on this machine ----


@pytest.fixture(scope="module")
def saying(tmp_path_factory):
    """Saves a tiny network, random but for one thing: after `prompt` it says `answer`.

    Its last layer looks at nothing but the place of the token, so any text can be put there.
    """
    pytest.importorskip("transformers")
    from tokenizers import Tokenizer, decoders, models, pre_tokenizers
    from transformers import GPT2Config, GPT2LMHeadModel, PreTrainedTokenizerFast

    letters = sorted(pre_tokenizers.ByteLevel.alphabet())
    vocabulary = {letter: i for i, letter in enumerate([*letters, "<end>"])}
    plain = Tokenizer(models.BPE(vocab=vocabulary, merges=[]))
    plain.pre_tokenizer = pre_tokenizers.ByteLevel(add_prefix_space=False)
    plain.decoder = decoders.ByteLevel()
    tokenizer = PreTrainedTokenizerFast(tokenizer_object=plain, eos_token="<end>")

    def save(prompt: str = "", answer: str = "") -> str:
        torch.manual_seed(0)
        size, places = len(vocabulary) + 1, 8000
        config = GPT2Config(
            vocab_size=len(vocabulary), n_positions=places, n_embd=size - size % 2,
            n_layer=1, n_head=2, eos_token_id=vocabulary["<end>"], bos_token_id=None,
            tie_word_embeddings=False,
        )  # fmt: skip
        network = GPT2LMHeadModel(config)
        if answer:
            _say(network, tokenizer, prompt, answer)
        folder = str(tmp_path_factory.mktemp("network"))
        network.save_pretrained(folder)
        tokenizer.save_pretrained(folder)
        return folder

    return save


@torch.no_grad()
def _say(network, tokenizer, prompt: str, answer: str) -> None:
    from edit3r_language.answers import system_prompt

    talk = [
        {"role": "system", "content": system_prompt()},
        {"role": "user", "content": prompt},
    ]
    start = len(tokenizer(_as_text(tokenizer, talk))["input_ids"]) - 1
    for weights in network.parameters():
        weights.zero_()
    network.transformer.ln_f.weight.fill_(1)
    count = len(tokenizer)
    network.lm_head.weight[:count, :count] = torch.eye(count)
    said = [*tokenizer(answer)["input_ids"], tokenizer.eos_token_id]
    network.transformer.wpe.weight[torch.arange(start, start + len(said)), said] = 1


def local(folder, **settings):
    return edit3r.build("reader", "local-model", model=folder, **settings)


@pytest.mark.slow
def test_a_model_of_this_machine_is_asked_and_read(saying):
    reader = local(saying(SENTENCE, RIGHT))
    assert list(map(str, reader.read(SENTENCE))) == ["wall: red"]


@pytest.mark.slow
def test_a_random_model_says_nothing_that_can_be_used(saying):
    with pytest.raises(RunError, match="gave no instructions for 'male die Wand rot'"):
        local(saying(), max_tokens=5, attempts=1).read(SENTENCE)


def test_without_a_form_of_its_own_a_model_is_given_all_of_the_talk_line_by_line():
    talk = [{"role": role, "content": role.upper()} for role in ("system", "user")]
    text = _as_text(SimpleNamespace(chat_template=None), talk)
    assert text == "system: SYSTEM\nuser: USER\nassistant: "


def test_a_folder_without_a_model_is_told_by_its_setting(tmp_path):
    pytest.importorskip("transformers")
    with pytest.raises(InputError, match=r"reader\.model"):
        local(str(tmp_path)).read(SENTENCE)


# ---- the contract ----


@pytest.mark.slow
@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["reader"])} - {*claims(Contract)})
)
def test_contract(chat, monkeypatch, claim):
    names = (
        {"instructions": [GIBBERISH]}
        if "not_understand" in claim
        else {"instructions": [INSTRUCTION]}
    )
    chat.answers.append(json.dumps(names))
    contract = contract_for("reader", "model", base_url=chat.url)
    contract.target = SENTENCE
    monkeypatch.setattr(ServiceReader, "example", SENTENCE)
    getattr(contract(), claim)()
