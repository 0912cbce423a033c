"""The cache of paid answers."""

from dataclasses import replace

from edit3r_remote.cache import AnswerCache
from edit3r_remote.service import Request, ServiceAnswer

REQUEST = Request("left.png", "paint it red", 0, b"image", None, (10, 20))
ANSWER = ServiceAnswer(b"answer", 3, 4)


def test_an_answer_is_found_again_and_an_unknown_key_is_not(tmp_path):
    cache = AnswerCache(str(tmp_path / "new" / "folder"))
    key = cache.key(REQUEST, {"model": "m"})
    assert cache.find(key) is None
    cache.keep(key, ANSWER)
    assert cache.find(key) == ANSWER and cache.find("0" * 64) is None


def test_an_answer_cut_short_by_a_crash_counts_as_absent(tmp_path):
    cache = AnswerCache(str(tmp_path))
    key = cache.key(REQUEST, {})
    cache.keep(key, ANSWER)
    (tmp_path / f"{key}.json").write_text('{"input_tok')
    assert cache.find(key) is None


def test_a_rejected_answer_is_on_disk_but_never_found(tmp_path):
    cache = AnswerCache(str(tmp_path))
    key = cache.key(REQUEST, {})
    path = cache.write(f"{key}.rejected", ANSWER.image)
    assert path.read_bytes() == b"answer" and cache.find(key) is None


def test_the_view_name_does_not_matter_but_mask_and_settings_do(tmp_path):
    cache = AnswerCache(str(tmp_path))
    key = cache.key(REQUEST, {"quality": "high"})
    assert cache.key(replace(REQUEST, name="other.png"), {"quality": "high"}) == key
    assert cache.key(replace(REQUEST, mask=b"mask"), {"quality": "high"}) != key
    assert cache.key(REQUEST, {"quality": "low"}) != key


def test_without_a_folder_nothing_is_kept():
    cache = AnswerCache("")
    assert cache.write("k.rejected", b"") is None and cache.find("k") is None
