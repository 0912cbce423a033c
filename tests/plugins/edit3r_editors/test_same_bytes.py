"""Edits by colours give the same bytes for any number of threads."""

import pytest
import torch

from edit3r.contract.types import EditRequest, Views
from edit3r.loading.registry import build
from edit3r.running.editors import read


@pytest.mark.parametrize(
    ("editor", "prompt"),
    [("recolor", "paint it gold"), ("recolor", "make it warmer"), ("looks", "sketch")],
)
def test_the_number_of_threads_changes_no_bit(editor, prompt):
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(1, 2, 3, 257, 311, generator=generator)
    views = Views(images, torch.eye(3).expand(1, 2, 3, 3))
    before = torch.get_num_threads()
    answers = []
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        answers.append(
            build("editor", editor)
            .edit(views, EditRequest(prompt, instructions=read(prompt)))
            .images
        )
    torch.set_num_threads(before)
    assert torch.equal(answers[0], answers[1])
    assert torch.equal(answers[0], answers[2])
