import json

from edit3r.contract.interfaces import Dataset


def log_of(folder) -> list[dict]:
    """The lines of a training's log."""
    lines = (folder / "log.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


class Data:
    """Stands before the data of a job; how far the training is says it nothing."""

    def __init__(self, data) -> None:
        self.data = data

    def __len__(self) -> int:
        return len(self.data)

    at_progress = Dataset.at_progress

    def __getitem__(self, index: int):
        return self.data[index]
