import pytest
from edit3r_training.schedule import batch_indices, step_generator, warmup_cosine


def test_learning_rate_rises_over_the_warmup_then_falls_to_the_floor():
    rates = [
        warmup_cosine(step, steps=100, warmup=10, floor=0.1) for step in range(101)
    ]
    assert rates[:10] == sorted(rates[:10]) and rates[9] == rates[10] == 1
    assert rates[10:] == sorted(rates[10:], reverse=True)
    assert rates[100] == pytest.approx(0.1)


@pytest.mark.parametrize("length", [1, 7, 12, 100])
def test_every_epoch_shows_each_sample_once(length):
    seen = [
        index
        for step in range(length)
        for index in batch_indices(step, 1, length, seed=3)
    ]
    assert sorted(seen) == list(range(length))


def test_epochs_differ_in_order():
    first = batch_indices(0, 50, 50, seed=0)
    second = batch_indices(1, 50, 50, seed=0)
    assert sorted(first) == sorted(second) and first != second


def test_processes_share_an_epoch_without_overlap():
    parts = [
        batch_indices(step, 4, 40, seed=1, rank=rank, world=2)
        for step in range(5)
        for rank in range(2)
    ]
    assert sorted(index for part in parts for index in part) == list(range(40))


def test_random_numbers_follow_from_seed_step_and_slot_alone():
    assert step_generator(1, 2, 3).random() == step_generator(1, 2, 3).random()
    assert (
        len(
            {
                step_generator(*key).random()
                for key in [(1, 2, 3), (1, 2, 4), (1, 3, 3), (2, 2, 3)]
            }
        )
        == 4
    )
