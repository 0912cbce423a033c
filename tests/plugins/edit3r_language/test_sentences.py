"""Sentences as people write them: each is read right, or what is not understood is named.

`sentences.yaml` says of each how it must be read.
"""

from pathlib import Path

import pytest
import yaml
from edit3r_language.grammar import GrammarReader
from edit3r_language.vocabulary import LOOKS

from edit3r.contract.errors import PromptError

read = GrammarReader().read

FILE = Path(__file__).parent / "sentences.yaml"
GROUPS = yaml.safe_load(FILE.read_text(encoding="utf-8"))
SENTENCES = [
    (str(sentence), reading)
    for group in GROUPS.values()
    for sentence, reading in group.items()
]


def not_understood(wish) -> tuple[str, ...]:
    """Words of a wish that nobody understands; a look that no editor has is one, too."""
    if wish.look and not set(wish.look.split()) & LOOKS:
        return tuple(wish.look.split())
    return wish.unread


@pytest.mark.parametrize(("sentence", "reading"), SENTENCES)
def test_a_sentence_is_read_right_or_its_unknown_words_are_named(sentence, reading):
    kind, _, said = reading.partition(" ")
    if kind == "!":
        with pytest.raises(PromptError, match=said):
            read(sentence)
        return
    wishes = read(sentence)
    unread = {word for wish in wishes for word in not_understood(wish)}
    if kind == "?":
        assert unread == set(said.split(", "))
    else:
        assert not unread
        assert " | ".join(map(str, wishes)) == reading


def test_there_are_enough_sentences():
    assert len(SENTENCES) >= 150
