"""A run's manifest says which weights were used."""

import hashlib

from edit3r_model.small.weights import SHIPPED, load_network

from edit3r.io.run_folder import WeightsRecord
from edit3r.reporting import Report, collecting


def test_shipped_weights_are_recorded_with_hash_and_licence():
    with collecting(Report()) as report:
        load_network("shipped")
    record = WeightsRecord(**report.notes["weights.edit3r"])
    assert record.file == SHIPPED.name and record.licence == "Apache-2.0"
    assert record.sha256 == hashlib.sha256(SHIPPED.read_bytes()).hexdigest()


def test_untrained_weights_are_none():
    with collecting(Report()) as report:
        load_network("untrained")
    assert "weights.edit3r" not in report.notes
