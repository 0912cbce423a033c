from dataclasses import replace

import numpy as np
import pytest
import torch
from edit3r_training.asymmetric_inputs import REGIMES, RegimeShares, edit_sample
from edit3r_training.batches import make_batch
from edit3r_training.procedural_dataset import ProceduralDataset

from edit3r.contract.errors import SettingsError

SAMPLE = ProceduralDataset(ProceduralDataset.Settings(image_size=48, scenes=2))[1]


def _edit(regime: str, seed: int = 0, sample=SAMPLE, **more):
    shares = {name: float(name == regime) for name in REGIMES}
    return edit_sample(
        sample,
        RegimeShares(**shares, **{"mask_jitter": 0, **more}),
        np.random.default_rng(seed),
    )


def test_reference_regime_recolours_view_0_only_and_asks_for_the_edit_everywhere():
    edit = _edit("reference")
    assert torch.equal(edit.edited[1], SAMPLE.context[1])
    assert torch.equal(edit.edited[0], edit.truth[0])
    assert not torch.allclose(edit.truth[1], SAMPLE.context[1], atol=0.02)
    assert not torch.allclose(edit.target, SAMPLE.target, atol=0.02)


def test_disagreeing_regime_gives_every_view_its_own_edit_and_asks_for_the_reference_s():
    edit = _edit("disagreeing")
    assert torch.equal(edit.edited[0], edit.truth[0])
    changed = (edit.edited[1] - SAMPLE.context[1]).abs().amax() > 0.02
    assert changed and not torch.allclose(edit.edited[1], edit.truth[1], atol=0.02)


def test_agreeing_regime_gives_the_truth_and_unedited_changes_nothing():
    edit, none = _edit("agreeing"), _edit("unedited")
    assert torch.equal(edit.edited, edit.truth)
    assert torch.equal(none.edited, SAMPLE.context)
    assert torch.equal(none.target, SAMPLE.target)


def test_viewwise_regime_asks_for_every_image_s_own_edit():
    edit = _edit("viewwise")
    assert torch.equal(edit.edited, edit.truth)
    changes = [
        (image - photo).mean((1, 2))
        for image, photo in zip(edit.edited, SAMPLE.context)
    ]
    assert (changes[0] - changes[1]).abs().max() > 0.02


def test_viewwise_regime_takes_the_edits_that_the_data_brings():
    own = replace(
        SAMPLE, edited_context=1 - SAMPLE.context, edited_target=1 - SAMPLE.target
    )
    edit = _edit("viewwise", sample=own)
    assert torch.equal(edit.edited, 1 - SAMPLE.context)
    assert torch.equal(edit.target, 1 - SAMPLE.target)


def test_two_regions_get_two_transforms_each_the_same_in_all_views():
    """On pictures of one grey: halves differ, views do not."""
    grey = torch.full_like(SAMPLE.context, 0.4)
    masks = torch.zeros(2, 2, 48, 48)
    masks[0, ..., :24], masks[1, ..., 24:] = 1, 1
    halves = replace(SAMPLE, context=grey, target=grey, context_depths=None)
    halves = replace(halves, context_masks=masks, target_masks=masks)
    edits = [_edit("reference", seed, halves, whole_picture=0) for seed in range(8)]
    colours = [[edit.truth[..., 0, x] for x in (0, -1)] for edit in edits]
    both = [c for c in colours if all((one - 0.4).abs().max() > 0.02 for one in c)]
    assert len(both) >= 2
    for left, right in both:
        assert (left - right).abs().max() > 0.02
        assert torch.equal(left[0], left[1]) and torch.equal(right[0], right[1])


OWN = ProceduralDataset(
    ProceduralDataset.Settings(image_size=48, scenes=2, edit="shape", edit_seed=3)
)[1]


def test_generated_regime_edits_view_0_as_the_data_does_and_asks_for_that_everywhere():
    edit = _edit("generated", sample=OWN)
    assert torch.equal(edit.edited[0], OWN.edited_context[0])
    assert torch.equal(edit.edited[1], OWN.context[1])
    assert torch.equal(edit.truth, OWN.edited_context)
    assert torch.equal(edit.target, OWN.edited_target)
    assert not torch.equal(edit.truth[1], OWN.context[1]) and edit.reshaped


def test_generated_regime_without_edits_of_the_data_is_one_sentence():
    with pytest.raises(SettingsError, match=r"^trainer.regimes.generated: .*edited"):
        _edit("generated")


def test_only_generated_edits_may_move_a_surface_and_only_where_they_changed_it():
    for regime, expected in (("generated", True), ("reference", False)):
        shares = {name: float(name == regime) for name in REGIMES}
        numbers = [np.random.default_rng(0)]
        batch = make_batch([OWN], RegimeShares(**shares), numbers, unit="baseline")
        assert bool(batch.reshaped.any()) == expected
    changed = (OWN.edited_context - OWN.context).abs().amax(1) > 0.02
    numbers = [np.random.default_rng(0)]
    shares = RegimeShares(**{name: float(name == "generated") for name in REGIMES})
    assert torch.equal(make_batch([OWN], shares, numbers).reshaped[0], changed)


def test_jittered_masks_spoil_the_input_but_not_the_truth():
    clean, jittered = (
        _edit("reference", whole_picture=0),
        _edit("reference", whole_picture=0, mask_jitter=1),
    )
    assert torch.equal(clean.truth, jittered.truth)
    assert not torch.equal(clean.edited[0], jittered.edited[0])


def test_a_jittered_palette_spoils_the_input_but_not_the_truth():
    clean, jittered = (
        _edit("reference", whole_picture=1, palette_jitter=share) for share in (0, 1)
    )
    assert torch.equal(clean.truth, jittered.truth)
    assert torch.equal(clean.edited[0], clean.truth[0])
    assert 0.002 < (jittered.edited[0] - clean.edited[0]).abs().mean() < 0.2


def test_data_without_masks_is_edited_as_a_whole():
    bare = replace(SAMPLE, context_masks=None, target_masks=None)
    edit = _edit("reference", sample=bare)
    assert ((edit.truth - SAMPLE.context).abs().amax(1) > 0.01).float().mean() > 0.5


@pytest.mark.parametrize("seed", range(3))
def test_regimes_are_drawn_from_the_seed(seed):
    shares = RegimeShares()
    first, second = (
        edit_sample(SAMPLE, shares, np.random.default_rng(seed)) for _ in range(2)
    )
    assert first.regime == second.regime and torch.equal(first.edited, second.edited)
