"""Sentences of edit3r as the page shows them: without the command line, which it does not have."""

import re

COMMAND = re.compile(r"--[a-z]|\bedit3r [a-z]|\bpip install\b|\bdocs/|\.ya?ml\b")
"""What only somebody at a command line can use."""
_BRACKETS = re.compile(r"\s*\(([^()]*)\)")
_SENTENCE = re.compile(r"(?<=[.!?])\s+")
_CLAUSE = re.compile(r"([;,:] (?:or |and )?)")
NOTHING_LEFT = "This cannot be done with these settings."


def in_app(text: str) -> str:
    """The text without every clause that speaks of flags, commands or files of settings.

    Of a text that speaks of nothing else, `NOTHING_LEFT` remains.
    """
    if not COMMAND.search(text):
        return text
    text = _BRACKETS.sub(lambda one: "" if COMMAND.search(one[1]) else one[0], text)
    kept = [_of_sentence(one) for one in _SENTENCE.split(text)]
    return " ".join(filter(None, kept)) or NOTHING_LEFT


def _of_sentence(sentence: str) -> str:
    """What is left of one sentence; "" where its first clause speaks of the command line."""
    if not COMMAND.search(sentence):
        return sentence
    first, *rest = _CLAUSE.split(sentence)
    if COMMAND.search(first):
        return ""
    kept, cut = [first], False
    for mark, clause in zip(rest[::2], rest[1::2]):
        if not COMMAND.search(clause):
            kept.append((mark[:2] if cut else mark) + clause)
        cut = bool(COMMAND.search(clause))
    end = sentence[-1] if sentence[-1] in ".!?" else ""
    return "".join(kept).rstrip(" .;,:") + end
