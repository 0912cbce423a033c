"""The contract of editors, kept against the fake service."""

import pytest

from edit3r_testing import CONTRACTS, Contract, claims, contract_for


@pytest.mark.slow
@pytest.mark.parametrize(
    "claim", sorted({*claims(CONTRACTS["editor"])} - {*claims(Contract)})
)
def test_contract(fake, editor_name, tmp_path, monkeypatch, claim):
    monkeypatch.setattr("edit3r_remote.gpt_image.SIZES", ((96, 128), (128, 96)))
    monkeypatch.setattr(
        "edit3r_remote.gemini_image.SHAPES", {(96, 128): "4:3", (128, 96): "3:4"}
    )
    base_url = f"{fake.url}/v1" if editor_name == "gpt-image" else fake.url
    contract = contract_for(
        "editor", editor_name, base_url=base_url, cache=str(tmp_path / "cache")
    )
    getattr(contract(), claim)()
