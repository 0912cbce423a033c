"""Sentences as people write them: each is read right, or what is not understood is named.

`sentences.yaml` says of each how it must be read.
"""

from pathlib import Path

import pytest
import yaml
from edit3r_language.grammar import GrammarReader
from edit3r_language.vocabulary import WORDS

from edit3r.contract.errors import PromptError

read = GrammarReader().read

FILE = Path(__file__).parent / "sentences.yaml"
GROUPS = yaml.safe_load(FILE.read_text(encoding="utf-8"))
SENTENCES = [
    (str(sentence), reading)
    for group in GROUPS.values()
    for sentence, reading in group.items()
]


def not_understood(instruction) -> tuple[str, ...]:
    """Words of an instruction that nobody understands; a look that no editor has is one, too."""
    if instruction.look and not set(instruction.look.split()) & WORDS.looks:
        return tuple(instruction.look.split())
    return instruction.unread


@pytest.mark.parametrize(("sentence", "reading"), SENTENCES)
def test_a_sentence_is_read_right_or_its_unknown_words_are_named(sentence, reading):
    kind, _, said = reading.partition(" ")
    if kind == "!":
        with pytest.raises(PromptError, match=said):
            read(sentence)
        return
    instructions = read(sentence)
    unread = {
        word for instruction in instructions for word in not_understood(instruction)
    }
    if kind == "?":
        assert unread == set(filter(None, said.split(", ")))
        assert {one.action for one in instructions} != {"paint"}
    else:
        assert not unread
        assert " | ".join(map(str, instructions)) == reading


def test_there_are_enough_sentences():
    assert len(SENTENCES) >= 150


def test_every_content_word_is_used_or_named():
    """A word that is left out of a sentence leaves the reading, or was a filler."""
    for sentence, reading in GROUPS["grammar"].items():
        said = " ".join(f"{one} {one.text}" for one in read(sentence))
        for word in ("red", "background", "except", "not", "without"):
            if word in sentence.lower().split() and not reading.startswith("?"):
                named = word in said or "without" in said or "background" in said
                assert named, sentence
