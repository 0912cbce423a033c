import json

from edit3r.training.journal import Journal


def _steps(path):
    return [json.loads(line)["step"] for line in path.read_text().splitlines()]


def test_lines_are_json_objects(tmp_path):
    journal = Journal(tmp_path)
    journal.write(1, {"loss": 0.5})
    journal.write(2, {"score": 0.25}, kind="validation")
    lines = [json.loads(line) for line in journal.path.read_text().splitlines()]
    assert [line["kind"] for line in lines] == ["train", "validation"]
    assert lines[0]["loss"] == 0.5 and lines[1]["step"] == 2


def test_resuming_takes_out_what_will_be_done_again(tmp_path):
    journal = Journal(tmp_path)
    for step in range(1, 6):
        journal.write(step, {"loss": 0.0})
    journal.path.write_text(journal.path.read_text() + '{"half a li')
    assert _steps(Journal(tmp_path, step=3).path) == [1, 2, 3]
