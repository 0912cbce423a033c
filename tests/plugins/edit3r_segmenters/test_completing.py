"""What another photo shows of a thing is completed by a network's answers."""

import numpy as np
from edit3r_segmenters.completing import completed


class TestCompleted:
    """A thing of two halves; the photo that says where it is shows only the left half."""

    THING = np.zeros((64, 96), bool)
    THING[16:48, 16:80] = True
    KNOWN = np.zeros((64, 96), bool)
    KNOWN[:, :48] = True
    EXPECTED = THING & KNOWN

    def of(self, *answers, expected=EXPECTED, known=KNOWN):
        logits = np.stack([np.where(answer, 4.0, -4) for answer in answers])
        return completed(expected, known, lambda clicks, box: logits)

    def test_an_answer_that_agrees_is_the_whole_thing(self):
        uneven = self.THING.copy()
        uneven[16, 16:48] = False  # where it is known, the network's outline holds too
        assert np.array_equal(self.of(self.KNOWN, uneven), uneven)

    def test_a_part_that_lies_within_it_adds_what_was_hidden(self):
        part = self.THING.copy()
        part[28:] = False
        assert np.array_equal(self.of(part), self.EXPECTED | part)

    def test_what_reaches_beyond_what_is_known_not_to_be_it_is_left(self):
        wide = np.zeros_like(self.THING)
        wide[12:52, 12:80] = True
        assert np.array_equal(self.of(wide), self.EXPECTED)

    def test_what_is_hardly_confirmed_is_left(self):
        far = np.zeros_like(self.THING)
        far[20:44, 44:] = True
        assert np.array_equal(self.of(far), self.EXPECTED)

    def test_where_all_is_known_no_network_is_asked(self):
        everywhere = np.ones_like(self.KNOWN)
        found = completed(self.EXPECTED, everywhere, None)
        assert np.array_equal(found, self.EXPECTED)
        nothing = np.zeros_like(self.KNOWN)
        assert not completed(nothing, nothing, None).any()

    def test_an_answer_that_surely_agrees_ends_the_questions(self):
        asked = []

        def prompt(clicks, box):
            asked.append(box)
            return np.where(self.THING, 4.0, -4)[None]

        assert np.array_equal(completed(self.EXPECTED, self.KNOWN, prompt), self.THING)
        assert asked == [((16, 16), (48, 48))]  # all places at once, in their box
