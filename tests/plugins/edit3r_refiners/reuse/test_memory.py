"""An answer is taken from memory exactly when everything it was computed from is the same."""

from dataclasses import replace

import pytest
import torch

from edit3r.interfaces import Proposal, Segmenter, Tracks
from edit3r.reporting import Report, collecting
from edit3r.reuse.fingerprint import fingerprint, identity
from edit3r.reuse.memory import Memory
from edit3r.reuse.parts import remembering


class Halves(Segmenter):
    """Left and right half of every picture."""

    def __init__(self):
        self.asked = []

    def propose(self, image):
        self.asked.append("propose")
        left = torch.zeros_like(image[0])
        left[:, : image.shape[2] // 2] = 0.75
        return tuple(Proposal(mask, 0.5, 0.9, 0.8, (0.0, 0.0, 4.0, 6.0)) for mask in (left, 0.75 - left))

    def segment(self, image, points=(), box=None):
        self.asked.append("segment")
        return self.propose(image)[0]

    def segment_text(self, image, text):
        self.asked.append("text")
        return None if text == "?" else ()

    def track(self, images, masks):
        self.asked.append("track")
        logits = (masks - 0.5)[None].expand(len(images), -1, -1, -1)
        return Tracks(logits.clone(), torch.ones(len(images), len(masks), dtype=torch.bool))


def test_a_matcher_is_asked_once_for_the_same_photos_and_settings(planted, tmp_path):
    views, build = planted.views, planted.registry.build
    first = Memory()
    geometry = remembering(first)(build("matcher", "planted")).match(views)
    first.save(tmp_path)
    report = Report()
    with collecting(report):
        again = Memory(tmp_path)
        kept = remembering(again)(build("matcher", "planted")).match(views)
        assert planted.calls == ["match"] and again.reused == ["match"]
        assert torch.equal(kept.depths, geometry.depths) and torch.equal(kept.c2w, geometry.c2w)
        assert torch.equal(kept.confidence, geometry.confidence) and torch.equal(kept.registered, geometry.registered)
        remembering(again)(build("matcher", "planted", depth=2.0)).match(views)
        remembering(again)(build("matcher", "planted")).match(replace(views, images=views.images.flip(1)))
    assert planted.calls == ["match"] * 3
    assert report.notes["reuse.reused"] == ["match"] and report.notes["reuse.computed"] == ["match", "match"]


def test_all_answers_of_a_segmenter_are_remembered(planted, tmp_path):
    def ask(memory):
        segmenter = Halves()
        stand_in, image = remembering(memory)(segmenter), planted.views.images[0, 0]
        masks = torch.stack([p.soft_mask for p in stand_in.propose(image)])
        texts = [stand_in.segment_text(image, text) for text in ("?", "none")]
        answers = (masks, stand_in.segment(image, [(0.5, 0.5)]), texts, stand_in.track(planted.views.images[0], masks))
        return segmenter.asked, answers

    first = Memory()
    asked, (masks, proposal, texts, tracks) = ask(first)
    first.save(tmp_path)
    asked_again, (masks_2, proposal_2, texts_2, tracks_2) = ask(Memory(tmp_path))
    assert len(asked) == 6 and asked_again == [] and texts_2 == texts == [None, ()]
    assert torch.equal(masks, masks_2) and torch.equal(tracks.logits, tracks_2.logits)
    assert torch.equal(proposal.soft_mask, proposal_2.soft_mask) and proposal.box == proposal_2.box


def test_a_reconstructor_s_parts_are_remembered_whoever_it_is(planted):
    memory = Memory()
    recon = planted.registry.turning_parts(remembering(memory)).build("reconstructor", "planted")
    for _ in range(2):
        recon(planted.views, planted.views)
    assert planted.calls == ["reconstruct", "match", "reconstruct"]


@pytest.mark.parametrize("change", [{"footprint": 0.5}, {"matcher": {"name": "planted", "depth": 2.0}}])
def test_settings_of_a_component_and_of_its_parts_are_its_identity(planted, change):
    build = planted.registry.build
    plain = identity(build("reconstructor", "planted"))
    assert plain == identity(build("reconstructor", "planted"))
    assert plain != identity(build("reconstructor", "planted", **change))


def test_trained_weights_are_part_of_the_identity(planted):
    recon = planted.registry.build("reconstructor", "planted")
    network = torch.nn.Linear(2, 2)
    type(recon).network = property(lambda self: network)
    try:
        before = identity(recon)
        with torch.no_grad():
            network.weight += 1e-3
        assert identity(recon) != before
    finally:
        del type(recon).network


def test_fingerprints_differ_by_value_shape_type_and_order():
    a = torch.arange(6.0)
    things = [(a,), (a.view(2, 3),), (a.double(),), (a + 1e-6,), (a, 1), (1, a), ([a], 1), ("1", a), (None,), ()]
    assert len({fingerprint(*thing) for thing in things}) == len(things)
